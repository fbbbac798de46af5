"""What is done with whole recordings: replayed, resumed, kept on a shelf, exported."""
