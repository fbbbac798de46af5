"""One module per instrument, each talking to the real thing through its own library."""
