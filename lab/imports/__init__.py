"""Measurements of other laboratories and programs, by a map that says what each column is, as a case."""
