"""What faults did to a run, as a table for people: the proofs print it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

MOST_WORDS = 6
_LONGEST = 160
_HEAD = "| fault | tried | worst delay, ms | lost | words |\n| --- | --- | --- | --- | --- |"


@dataclass
class Row:
    """One fault.

    Attributes:
        fault: what happened.
        tried: how often.
        delays: the worst, s, by what they are the delay of.
        lost: what was not as it must be, each with where.
        words: that the referee got, and how often.
    """

    fault: str
    tried: int = 0
    delays: dict[str, float] = field(default_factory=dict)
    lost: list[str] = field(default_factory=list)
    words: Counter[str] = field(default_factory=Counter)

    def add(
        self, where: str, delays: Mapping[str, float], wrong: Sequence[str], words: Iterable[str]
    ) -> None:
        """One more try."""
        self.tried += 1
        for name, delay in delays.items():
            self.delays[name] = max(delay, self.delays.get(name, delay))
        if wrong:
            self.lost.append(f"{where}: {'; '.join(wrong)}")
        self.words.update(words)

    def __str__(self) -> str:
        delays = ", ".join(f"{name} {1000 * delay:.0f}" for name, delay in self.delays.items())
        words = " / ".join(
            f"{count} x {word[:_LONGEST]}" for word, count in self.words.most_common(MOST_WORDS)
        )
        return f"| {self.fault} | {self.tried} | {delays} | {len(self.lost)} | {words} |"


def fault_table(rows: Sequence[Row]) -> str:
    """The rows, and below them in full what was lost."""
    lost = [f"{row.fault}: {one[:1500]}" for row in rows for one in row.lost]
    return "\n".join(["", _HEAD, *map(str, rows), *lost])
