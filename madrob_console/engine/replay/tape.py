"""A recorded run, read once, to be gone through as often as one likes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from madrob_console.archive.comparison import Stored, compared
from madrob_console.archive.rescore import read_recorded_run
from madrob_console.archive.run_record import RECORD_NAME
from madrob_console.errors import MadrobError
from madrob_console.messages.codec import MessageTypes
from madrob_console.referee.journal import Entry
from madrob_console.testbeds.recorded_bag import ReplaySource
from recorder.errors import RecorderError
from scoring.result import Result


class Tape:
    """Bag, journal and stored result of one run.

    Args:
        path: a bag or a run folder.
        types: the message types; those of the bag are registered.

    Attributes:
        types: the message types.
        source: the bag.
        recorded: what bag and journal say of the run.
        start: of the run, s since the epoch.

    Raises:
        MadrobError: there is no run to be replayed.
    """

    def __init__(self, path: Path, types: MessageTypes) -> None:
        self.types = types
        self.source = ReplaySource(path, types)
        if RECORD_NAME not in self.source.records:
            raise MadrobError(f"{path}: a bag without a MADROB run cannot be replayed")
        try:
            self.recorded = read_recorded_run(path)
        except RecorderError as error:
            raise MadrobError(str(error)) from None
        assert self.recorded.run.start is not None
        self.start = self.recorded.run.start
        self.source.expect(self.recorded.record.mappings)
        self._stored = Stored.read(path)
        self._lost = tuple(_lost_lines(self.recorded.entries, self.source.journal_lines))

    @property
    def problems(self) -> tuple[str, ...]:
        """What is wrong with the recording, in words."""
        return (*self.recorded.remarks, *self.source.problems, *self._lost)

    def compare(self, result: Result) -> str:
        """What a result is beside the stored one, in words."""
        return compared(self._stored, result)


def _lost_lines(entries: Sequence[Entry], recorded: Sequence[str]) -> Iterator[str]:
    """Says it where a run's journal lacks lines that were recorded in its bag, too."""
    known = {entry.to_json() for entry in entries}
    if lost := sum(line not in known for line in recorded):
        yield f"the journal lacks {lost} of the {len(recorded)} lines that the bag has of it"
