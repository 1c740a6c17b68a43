"""The open recording of one run: its folder, its bag."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from madrob_console.engine.record import RECORD_NAME, RunRecord
from madrob_console.engine.snapshot import RecorderView
from madrob_console.errors import MadrobError
from madrob_console.runs import RunId, reserve_run_folder
from recorder.bag import Topic
from recorder.errors import RecorderError
from recorder.message import RawMessage
from recorder.stats import BagSummary
from recorder.writer import BagWriter


class Recording:
    """Records one run into a new folder.

    Args:
        root: the results folder.
        record: what is set for the run.
        start: planned start, s since the epoch; stands in the folder's name.
        topics: those known by now; more can be added.
        lossless: wait for the disk instead of dropping (virtual time).

    Raises:
        MadrobError: the folder or the bag cannot be made; the message names the remedy.
    """

    def __init__(
        self,
        root: Path,
        record: RunRecord,
        start: float,
        topics: Sequence[Topic],
        *,
        lossless: bool,
    ) -> None:
        setup = record.setup
        run_id = RunId(setup.subject, setup.condition.number, setup.run_number)
        self.folder = reserve_run_folder(root, run_id, start)
        self._topics = {topic.name for topic in topics}
        self._writer = BagWriter(
            self.folder, topics, {RECORD_NAME: record.to_metadata()}, block_when_full=lossless
        )
        try:
            self._writer.open()
        except RecorderError as error:
            raise MadrobError(str(error)) from None

    def add_topics(self, topics: Sequence[Topic]) -> None:
        """Record topics that appeared late, too."""
        for topic in topics:
            if topic.name not in self._topics:
                self._topics.add(topic.name)
                self._writer.add_topic(topic)

    def put(self, message: RawMessage) -> None:
        """Hand a message to the writer; what it must drop is counted."""
        self._writer.put(message)

    def dropped(self) -> dict[str, int]:
        """Messages dropped, by topic."""
        return dict(self._writer.stats().dropped)

    def view(self) -> RecorderView:
        """The recorder as screens show it."""
        stats = self._writer.stats()
        return RecorderView(
            state=stats.state.value,
            messages=stats.written,
            size=stats.file_bytes,
            dropped=sum(stats.dropped.values()),
            problem=stats.error,
        )

    def close(self) -> BagSummary:
        """Write what is queued and finish the bag."""
        return self._writer.close()
