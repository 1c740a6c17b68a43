"""A recorded run as it went, once more."""
