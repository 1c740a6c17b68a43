"""The one root exception of `scoring`."""


class ScoringError(Exception):
    """Something given to `scoring` cannot be used; the message names it and the remedy."""
