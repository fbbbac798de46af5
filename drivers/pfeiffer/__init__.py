"""The Pfeiffer vacuum gauge."""
