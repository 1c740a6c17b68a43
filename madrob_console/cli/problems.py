"""How a command says what is wrong."""

from __future__ import annotations

import sys

from madrob_console.names import terminal_safe

BAD_INPUT = 2
"""Exit code of bad input and of refusals; also argparse's."""


def complain(problem: object) -> None:
    """Name a problem on a line of the error output.

    Args:
        problem: a text, or the error whose message names the cause and the remedy.
    """
    print(f"madrob: {terminal_safe(str(problem))}", file=sys.stderr, flush=True)
