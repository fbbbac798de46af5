"""Motion capture by OptiTrack Motive."""
