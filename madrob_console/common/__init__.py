"""What all rooms share: errors, clock, names, version, and files that may be hostile."""
