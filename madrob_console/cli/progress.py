"""A progress bar on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeAlias, TypeVar

from madrob_console.cli.safe_stream import raw, safe_output

_Item = TypeVar("_Item")

Tell: TypeAlias = Callable[[int, int], None]
"""Takes how many are done, and of how many."""


@contextmanager
def progress(what: str) -> Iterator[Tell]:
    """Show a progress bar below the output while inside, if the error output is a terminal.

    `what` names what is counted: `runs`. Until the first count, and where there is only one, the
    bar shows that work goes on.
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


def counted_off(items: Sequence[_Item], what: str) -> Generator[_Item, None, None]:
    """Yield the items one by one, with a progress bar."""
    with progress(what) as tell:
        for number, item in enumerate(items):
            tell(number, len(items))
            yield item
        tell(len(items), len(items))
