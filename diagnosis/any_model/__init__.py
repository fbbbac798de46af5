"""What a plan can tell, before it is measured: robots drawn under it, and how often each cause would be named."""
