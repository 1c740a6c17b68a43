"""A bar that tells how far a command is, on a terminal only."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeAlias

from madrob_console.cli.safe_output import raw, safe_output

Tell: TypeAlias = Callable[[int, int], None]
"""Is told how many are done, and of how many."""


@contextmanager
def progress(what: str) -> Iterator[Tell]:
    """While inside, a bar below what is printed; nothing where the error output is no terminal.

    Args:
        what: is counted: `runs`.

    Yields:
        What is told how many are done; until it is, and where there is only one, the bar says
        that work goes on.
    """
    if not sys.stderr.isatty():
        yield lambda _done, _total: None
        return
    from rich import progress as rich
    from rich.console import Console

    bar = rich.Progress(
        what,
        rich.BarColumn(bar_width=24),
        rich.MofNCompleteColumn(),
        rich.TimeElapsedColumn(),
        "left",
        rich.TimeRemainingColumn(),
        console=Console(file=raw(sys.stderr)),
        transient=True,
        redirect_stdout=sys.stdout.isatty(),
    )
    with bar, safe_output():
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(
            task, completed=done, total=total if total > 1 else None
        )
