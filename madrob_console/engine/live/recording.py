"""The open recording of one run: its folder, its bag."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from madrob_console.archive.folders import RunId, reserve_run_folder
from madrob_console.archive.run_record import RECORD_NAME, RunRecord
from madrob_console.engine.shown.snapshot import RecorderView
from madrob_console.errors import MadrobError
from recorder.bag import Topic
from recorder.errors import RecorderError
from recorder.message import RawMessage
from recorder.stats import BagSummary, RecorderState
from recorder.writer import BagWriter

_LOOK_PERIOD = 1.0
"""The folder is looked at this often, s."""


class Recording:
    """Records one run into a new folder.

    Args:
        root: the results folder.
        record: what is set for the run.
        start: planned start, s since the epoch; stands in the folder's name.
        topics: those known by now; more can be added.
        lossless: wait for the disk instead of dropping (virtual time).
        monotonic: a clock of the machine's, s.

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
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        setup = record.setup
        run_id = RunId(setup.subject, setup.condition.number, setup.run_number)
        self.folder = reserve_run_folder(root, run_id, start)
        self._topics = {topic.name for topic in topics}
        self._monotonic = monotonic
        self._looked = monotonic()
        self._folder_problem: str | None = None
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
        problem = stats.error
        if stats.state is RecorderState.RECORDING:
            problem = self._problem_of_folder()
        return RecorderView(
            state=stats.state.value,
            messages=stats.written,
            size=stats.file_bytes,
            dropped=sum(stats.dropped.values()),
            problem=problem,
        )

    def _problem_of_folder(self) -> str | None:
        """Why no result could be written beside the recording, which goes on in its open file."""
        now = self._monotonic()
        if now - self._looked >= _LOOK_PERIOD:
            self._looked, self._folder_problem = now, None
            if not os.access(self.folder, os.W_OK | os.X_OK):
                why = "cannot be written" if os.path.lexists(self.folder) else "is gone"
                self._folder_problem = f"{self.folder} {why}: the result would not be on disk"
        return self._folder_problem

    def remarks(self) -> tuple[str, ...]:
        """What is not in the recording and why, in words, for the result's data quality."""
        stats = self._writer.stats()
        failed = [] if stats.error is None else [stats.error.replace(str(self.folder), "the bag")]
        missing = sorted(stats.dropped.items())
        return (
            *failed,
            *(f"{topic}: {n} messages are not in the recording" for topic, n in missing if n),
        )

    def close(self) -> BagSummary:
        """Write what is queued and finish the bag."""
        return self._writer.close()
