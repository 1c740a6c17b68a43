"""Numbers in, scores out."""
