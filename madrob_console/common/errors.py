"""The one root exception of `madrob_console`."""


class MadrobError(Exception):
    """The console cannot do what was asked; the message names the cause and the remedy."""
