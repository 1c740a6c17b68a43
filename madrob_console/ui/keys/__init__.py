"""Which key does what, and what it asks before."""
