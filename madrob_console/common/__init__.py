"""What all rooms share: errors, clock, names, version, formats, and files that may be hostile."""
