"""Bytes in, MCAP out."""
