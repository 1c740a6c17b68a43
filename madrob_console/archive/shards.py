"""Shares of many runs: each shard has its own, and all shards together have every run once."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from dataclasses import dataclass

from madrob_console.archive.run_paths import RunPath
from madrob_console.errors import MadrobError

_FORM = re.compile(r"([0-9]{1,7})/([0-9]{1,7})", re.ASCII)


@dataclass(frozen=True, slots=True)
class Shard:
    """One of several shares of the runs.

    Which share a run is in follows from its own name alone (that of its folder, bag or files):
    machines that see it under other paths, and tasks that start hours apart while runs come in,
    agree on it. All copies of a run are in one share, and shares are about equally large.

    Attributes:
        number: which, from 1.
        count: how many there are.
    """

    number: int
    count: int

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def __contains__(self, run: RunPath) -> bool:
        digest = hashlib.sha256(run.own_name.encode(errors="surrogateescape")).digest()
        return int.from_bytes(digest[:8]) % self.count == self.number - 1

    @property
    def folder_name(self) -> str:
        """How a folder of its files is called."""
        return f"shard_{self.number}_of_{self.count}"

    @classmethod
    def parse(cls, text: str) -> Shard:
        """A shard from `2/8`.

        Raises:
            MadrobError: it is none.
        """
        match = _FORM.fullmatch(text)
        if match is None or not 1 <= int(match[1]) <= int(match[2]):
            raise MadrobError(f"'{text}': give i/n, from 1/n to n/n")
        return cls(int(match[1]), int(match[2]))


def shared_out(runs: Iterable[RunPath], shard: Shard | None) -> list[RunPath]:
    """The runs of a share, in their order; None = all of them."""
    return [run for run in runs if shard is None or run in shard]
