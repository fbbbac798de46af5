"""Bytes to messages and back: writing, reading, verifying, recovering one MCAP file."""
