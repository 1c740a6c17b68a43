"""The open recording of one run: its folder, its bag."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from functools import partial
from pathlib import Path

from madrob_console.archive.folders import RunName, reserve_run_folder
from madrob_console.archive.run_record import RECORD_NAME, RunRecord
from madrob_console.engine.live.reading import Reader
from madrob_console.engine.shown.snapshot import RecorderView
from madrob_console.errors import MadrobError
from recorder.bag import Topic
from recorder.errors import RecorderError
from recorder.message import RawMessage
from recorder.stats import BagSummary, DropReason, RecorderState
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
        reading: looks at the folder now and then.
        evidence: whether others record into the folder, too.
        monotonic: a clock of the machine's, s.

    Raises:
        MadrobError: the folder or the bag cannot be made; the message names the remedy.
    """

    def __init__(  # noqa: PLR0913  what it records, and with what
        self,
        root: Path,
        record: RunRecord,
        start: float,
        topics: Sequence[Topic],
        *,
        lossless: bool,
        reading: Reader,
        evidence: bool = False,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        setup = record.setup
        name = RunName(setup.subject, setup.condition.number, setup.run_number)
        self.folder = reserve_run_folder(root, name, start, practice=setup.practice)
        self._topics = {topic.name for topic in topics}
        self._scored = {mapping.topic for mapping in record.mappings}
        self._monotonic = monotonic
        self._reading = reading
        self._looked = monotonic()
        self._answered = True
        self._folder_problem: str | None = None
        self._writer = BagWriter(
            self.folder, topics, {RECORD_NAME: record.to_metadata()}, block_when_full=lossless
        )
        try:
            self._writer.open()
        except RecorderError as error:
            raise MadrobError(str(error)) from None
        self._evidence_folder = _handle_of(self.folder) if evidence else None

    def add_topics(self, topics: Sequence[Topic]) -> None:
        """Record topics that appeared late, too."""
        for topic in topics:
            if topic.name not in self._topics:
                self._topics.add(topic.name)
                self._writer.add_topic(topic)

    def put(self, messages: Iterable[RawMessage]) -> None:
        """Hand messages to the writer; what it must drop is counted."""
        self._writer.put_all(messages)

    def take_evidence_folder(self) -> int | None:
        """The handle of the folder for who records evidence, and closes it; None = there is none.

        It is given once, and stays good when the folder is renamed.
        """
        handle, self._evidence_folder = self._evidence_folder, None
        return handle

    def dropped(self) -> dict[str, int]:
        """Messages dropped, by topic."""
        return dict(self._writer.stats().dropped)

    @property
    def silent(self) -> float:
        """How long the disk has taken nothing of what is recorded, s. From any thread."""
        stats = self._writer.stats()
        since = stats.seconds_since_sync if stats.state is RecorderState.RECORDING else None
        return since or 0.0

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
            queued=stats.queued_bytes,
        )

    def _problem_of_folder(self) -> str | None:
        """Why no result could be written beside the recording, which goes on in its open file."""
        now = self._monotonic()
        if self._answered and now - self._looked >= _LOOK_PERIOD:
            self._looked, self._answered = now, False
            self._reading.ask(partial(_problem_of, self.folder), self._heard_of_folder)
        return self._folder_problem

    def _heard_of_folder(self, answer: Future[str | None]) -> None:
        self._answered = True
        self._folder_problem = None if answer.exception() else answer.result()

    def remarks(self) -> tuple[str, ...]:
        """What is not in the recording and why, in words, for the result's data quality."""
        stats = self._writer.stats()
        failed = [] if stats.error is None else [stats.error.replace(str(self.folder), "the bag")]
        missing = sorted(stats.dropped.items())
        return (
            *failed,
            *(f"{topic}: {n} messages are not in the recording" for topic, n in missing if n),
        )

    @property
    def unrecorded(self) -> int:
        """Messages that were scored and are not in the recording; those of another type are not."""
        stats = self._writer.stats()
        missing = sum(n for topic, n in stats.dropped.items() if topic in self._scored)
        return max(0, missing - stats.drop_reasons.get(DropReason.OTHER_TYPE, 0))

    def close(self) -> BagSummary:
        """Write what is queued and finish the bag; waits for the disk as long as it takes."""
        if (handle := self.take_evidence_folder()) is not None:
            os.close(handle)
        return self._writer.close(None)


def _problem_of(folder: Path) -> str | None:
    if os.access(folder, os.W_OK | os.X_OK):
        return None
    why = "cannot be written" if os.path.lexists(folder) else "is gone"
    return f"{folder} {why}: the result would not be on disk"


def _handle_of(folder: Path) -> int | None:
    try:
        return os.open(folder, os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return None  # the run goes on; no evidence is recorded, which is told
