"""The referee's domain: states of a run, acts, checks, journal."""
