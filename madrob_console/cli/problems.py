"""How a command says what is wrong."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from types import TracebackType
from typing import Self

from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe

BAD_INPUT = 2
"""Exit code of bad input and of refusals; also argparse's."""

MOST_ALIKE = 3
"""So many problems of one kind are told one by one; the others are counted."""


class StoppedError(MadrobError):
    """A signal stopped the command before anything was begun.

    Args:
        what: in words.
        number: of the signal.

    Attributes:
        exit_code: as shells have it.
    """

    def __init__(self, what: str, number: int) -> None:
        super().__init__(what)
        self.exit_code = 128 + number


def complain(problem: object) -> None:
    """Name a problem on a line of the error output.

    Args:
        problem: a text, or the error whose message names the cause and the remedy.
    """
    print(f"madrob: {terminal_safe(str(problem))}", file=sys.stderr, flush=True)


def name_twins(pairs: Sequence[tuple[str, str]]) -> None:
    """Name runs that are there several times; of many the first.

    Args:
        pairs: of each two places.
    """
    for place, other in pairs[:MOST_ALIKE]:
        complain(f"note: {place} is the same run as {other}")
    if len(pairs) > MOST_ALIKE:
        complain(f"note: and {len(pairs) - MOST_ALIKE} more runs that are there twice")


class Complaints:
    """Names the problems of many things; what is the same of all of them is counted at the end.

    Attributes:
        count: how many there were.
    """

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

    def add(self, problem: object, of: object) -> None:
        """Name a problem.

        Args:
            problem: as for `complain`.
            of: what it is a problem of, as the problem names it.
        """
        self.count += 1
        words = str(problem).replace(str(of), "").strip(": ")
        self._alike[words] += 1
        if self._alike[words] <= MOST_ALIKE:
            complain(problem)

    def add_each(self, problems: Iterable[tuple[str, str]]) -> None:
        """Name problems.

        Args:
            problems: of each, what it is a problem of, and the problem.
        """
        for of, problem in problems:
            self.add(f"{of}: {problem}", of)
