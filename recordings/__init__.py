"""MCAP in and out: messages, writer, reader, replay, and the table of trials."""
