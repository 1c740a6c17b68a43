"""The open files of one run: its folder, bag and journal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from madrob_console.archive.folders import RunName, reserve_run_folder
from madrob_console.archive.run_record import RECORD_NAME, RunRecord
from madrob_console.common.errors import MadrobError
from madrob_console.common.plain_files import OpenFolder
from madrob_console.engine.runtime.journal_writer import OpenJournal
from madrob_console.engine.snapshot import RecorderView
from madrob_console.referee.journal import Entry
from recorder import RecorderError
from recorder.bag import RawMessage, Topic
from recorder.writer import BagWriter, RecorderState


class Recording:
    """Records one run into a new folder, in which it begins its journal.

    Args:
        start: planned start, s since the epoch; stands in the folder's name.
        topics: those known by now; more can be added.
        entries: the journal's first lines; the last one is the start.
        lossless: wait for the disk instead of dropping (virtual time).

    Attributes:
        is_open: whether the bag is not complete yet.
    """

    def __init__(
        self,
        root: Path,
        record: RunRecord,
        start: float,
        topics: Sequence[Topic],
        entries: Sequence[Entry],
        *,
        lossless: bool,
    ) -> None:
        self.is_open = True
        setup = record.setup
        name = RunName(setup.subject, setup.condition.number, setup.run_number)
        self.record = record
        self.entries = entries
        self.folder = reserve_run_folder(root, name, start, practice=setup.practice)
        self._types = {topic.name: topic.type for topic in topics}
        self._of_other_type: Counter[str] = Counter()
        self._scored = {mapping.topic for mapping in record.mappings}
        self._writer = BagWriter(
            self.folder, topics, {RECORD_NAME: record.to_metadata()}, block_when_full=lossless
        )
        try:
            self._writer.open()
        except RecorderError as error:
            raise MadrobError(str(error)) from None
        try:
            self.journal = OpenJournal.create(OpenFolder(self.folder), entries)
        except (MadrobError, OSError):
            self.close()
            raise

    def give_up(self, withdrawal: Entry) -> None:
        """Close it all: the run does not start. Its folder stays, its number is used."""
        self.journal.append([withdrawal], again=False)
        self.journal.close()
        self.close()

    def add_topics(self, topics: Sequence[Topic]) -> None:
        for topic in topics:
            if topic.name not in self._types:
                self._types[topic.name] = topic.type
                self._writer.add_topic(topic)

    def record_messages(self, messages: Iterable[RawMessage]) -> None:
        fitting = []
        for message in messages:
            if self._types.get(message.topic, message.type) == message.type:
                fitting.append(message)
            else:  # its readings are not scored either
                self._of_other_type[message.topic] += 1
        self._writer.put_all(fitting)

    def dropped(self) -> dict[str, int]:
        return dict(Counter(self._writer.stats().lost) + self._of_other_type)

    @property
    def silent(self) -> float:
        """How long the disk has taken nothing of the recording, s. From any thread."""
        stats = self._writer.stats()
        since = stats.seconds_since_sync if stats.state is RecorderState.RECORDING else None
        return since or 0.0

    def view(self) -> RecorderView:
        stats = self._writer.stats()
        return RecorderView(
            state=stats.state.value,
            messages=sum(stats.recorded.values()),
            size=stats.file_bytes,
            dropped=sum(self.dropped().values()),
            problem=stats.error,
        )

    def remarks(self) -> tuple[str, ...]:
        stats = self._writer.stats()
        failed = [] if stats.error is None else [stats.error.replace(str(self.folder), "the bag")]
        missing = sorted(self.dropped().items())
        return (
            *failed,
            *(f"{topic}: {n} messages are not in the recording" for topic, n in missing),
        )

    @property
    def unrecorded(self) -> int:
        """Messages that were scored and are not in the recording."""
        lost = self._writer.stats().lost
        return sum(n for topic, n in lost.items() if topic in self._scored)

    def close(self) -> None:
        """Write what is queued and finish the bag; waits for the disk as long as it takes.

        The journal goes on.
        """
        self._writer.close(None)
