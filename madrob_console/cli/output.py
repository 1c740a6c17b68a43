"""What commands print and ask at the terminal: problems, and questions."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Self

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe

BAD_INPUT = 2
"""Exit code of bad input and of refusals; also argparse's."""

MOST_ALIKE = 3
"""Problems of one kind that are printed one by one; the others are counted."""


class StoppedError(MadrobError):
    """A signal stopped the command before anything was begun; `exit_code` is that of shells."""

    def __init__(self, what: str, number: int) -> None:
        super().__init__(what)
        self.exit_code = 128 + number


def complain(problem: object) -> None:
    print(f"madrob: {terminal_safe(str(problem))}", file=sys.stderr, flush=True)


def name_some(notes: Sequence[str], more: str) -> None:
    """Print the first notes; `more` says what the others are, which are counted."""
    for note in notes[:MOST_ALIKE]:
        complain(f"note: {note}")
    if len(notes) > MOST_ALIKE:
        complain(f"note: and {len(notes) - MOST_ALIKE} more {more}")


def name_twins(pairs: Sequence[tuple[str, str]]) -> None:
    notes = [f"{place} is the same run as {other}" for place, other in pairs]
    name_some(notes, "runs that are there twice")


class Complaints:
    """Prints the problems of many things; counts repeated ones and prints the number at the end."""

    def __init__(self) -> None:
        self.count = 0
        self._alike: Counter[str] = Counter()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, _error: object, _trace: TracebackType | None
    ) -> None:
        for words, count in self._alike.items():
            if count > MOST_ALIKE:
                complain(f"and {count - MOST_ALIKE} more like it: {words}")

    def add_complaint(self, problem: object, of: object) -> None:
        """Print a problem, as `complain` does; `of` is the thing as the problem names it."""
        self.count += 1
        words = str(problem).replace(str(of), "").strip(": ")
        self._alike[words] += 1
        if self._alike[words] <= MOST_ALIKE:
            complain(problem)

    @contextmanager
    def complaining(self, of: object) -> Iterator[None]:
        """Print the MadrobError of the block, and go on."""
        try:
            yield
        except MadrobError as error:
            self.add_complaint(error, of)

    def add_each(self, problems: Iterable[tuple[str, str]]) -> None:
        for of, problem in problems:
            self.add_complaint(f"{of}: {problem}", of)


def somebody_there() -> bool:
    return sys.stdin.isatty() and sys.stdout.isatty()


def says_yes(question: str) -> bool:
    if not somebody_there():
        return False
    try:
        return input(question).strip().lower() in ("y", "yes")
    except EOFError:
        print()
        return False
