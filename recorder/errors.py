"""The one root exception of `recorder`."""


class RecorderError(Exception):
    """A bag cannot be written or read; the message names it and the remedy."""
