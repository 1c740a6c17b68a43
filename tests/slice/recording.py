"""The open files of one run: its folder, bag and journal. Whatever is called here may wait."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from madrob_console.archive.folders import JOURNAL_FILE, RunName, reserve_run_folder
from madrob_console.archive.run_record import RECORD_NAME, RunRecord
from madrob_console.common.errors import MadrobError
from madrob_console.referee.journal import Entry, Journal
from recorder import BagWriter, RecorderError, Topic


class Recording:
    """One run on its way to the disk.

    Args:
        start: the planned start, s since the epoch; it stands in the folder's name.
        entries: the first lines of its journal; the last one is the start's.
        lossless: let messages wait for the disk instead of losing them (virtual time).

    Raises:
        MadrobError, OSError: the disk refuses it.
    """

    def __init__(
        self,
        results: Path,
        record: RunRecord,
        start: float,
        topics: Sequence[Topic],
        entries: Sequence[Entry],
        *,
        lossless: bool = False,
    ) -> None:
        setup = record.setup
        name = RunName(setup.subject, setup.condition.number, setup.run_number)
        self.record = record
        self.folder = reserve_run_folder(results, name, start, practice=setup.practice)
        records = {RECORD_NAME: record.to_metadata()}
        self.bag = BagWriter(self.folder, topics, records, block_when_full=lossless)
        try:
            self.bag.open()
        except RecorderError as error:
            raise MadrobError(str(error)) from None
        self._journal = Journal()
        try:
            self._journal.open(self.folder / JOURNAL_FILE)
            self._append(entries)
        except OSError:
            self._journal.close()
            self.bag.close()
            raise

    def append(self, entry: Entry) -> None:
        """Write a line, on disk on return.

        OSError where the disk refuses it.
        """
        self._append([entry])

    def _append(self, entries: Sequence[Entry]) -> None:
        self._journal.append(entries)
        if self._journal.refused is not None:
            raise self._journal.refused

    def give_up(self, withdrawal: Entry) -> None:
        """Close a run that was withdrawn: its number is used, its folder stays."""
        self.append(withdrawal)
        self.close_bag()
        self.close()

    def close_bag(self) -> None:
        """Finish the bag, as long as the disk takes.

        The journal goes on.
        """
        self.bag.close(None)

    def close(self) -> None:
        self._journal.close()
