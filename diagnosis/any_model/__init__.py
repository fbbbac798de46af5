"""The diagnosis of any forward function: which of the causes that a person lists explains the gap between model and data."""
