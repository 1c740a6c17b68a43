"""Recorded runs, and the digits to which they are scored."""
