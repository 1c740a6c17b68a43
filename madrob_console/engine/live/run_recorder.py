"""The recording of the run at hand, from its start to the end of its post-roll."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from madrob_console.archive.run_record import RunRecord
from madrob_console.engine.live.chronicle import Chronicle
from madrob_console.engine.live.engine_config import EngineConfig
from madrob_console.engine.live.recording import Recording
from madrob_console.engine.shown.snapshot import RecorderView
from madrob_console.errors import MadrobError
from madrob_console.referee.run import Run
from madrob_console.testbeds.source import Source
from recorder.message import RawMessage


class RunRecorder:
    """Opens and closes the recording of one run after the other, and knows what it lacks.

    Args:
        source: the testbed.
        config: where runs are kept, and what stands in their record.
        chronicle: writes into the run's folder and its bag, too.
    """

    def __init__(self, source: Source, config: EngineConfig, chronicle: Chronicle) -> None:
        self._source = source
        self._config = config
        self._chronicle = chronicle
        self._recording: Recording | None = None
        self._closed_view = RecorderView("closed")
        self._lost_before: dict[str, int] = {}

    @property
    def recording(self) -> bool:
        """Whether a bag is open."""
        return self._recording is not None

    def clear(self) -> None:
        """Nothing is to be said any more of the recording before."""
        self._closed_view = RecorderView("closed")

    def start(self, run: Run) -> tuple[RunRecord, Path]:
        """Record a run; returns what is set for it, and its folder.

        Raises:
            MadrobError: the folder or the bag cannot be made; the message names the remedy.
        """
        assert run.setup is not None
        assert run.start is not None
        config = self._config
        record = RunRecord(
            setup=run.setup,
            handle_zero=run.handle_zero,
            thresholds=config.thresholds,
            mappings=config.mappings,
            source=self._source.kind,
            competition=config.competition,
            version=config.version,
        )
        recording = Recording(
            config.results, record, run.start, self._source.topics(), lossless=config.lossless
        )
        try:
            self._chronicle.attach(recording)
        except MadrobError:
            recording.close()
            raise
        self._recording = recording
        self._lost_before = self._lost()
        return record, recording.folder

    def discard(self) -> None:
        """A start that could not take effect: its folder stays, its number is used."""
        self._chronicle.detach()
        if self._recording is not None:
            self._recording.close()
        self._recording = None

    def put(self, message: RawMessage) -> None:
        """Record a message if a bag is open."""
        if self._recording is not None:
            self._recording.put(message)

    def look(self) -> None:
        """Record topics that appeared late, too."""
        if self._recording is not None:
            self._recording.add_topics(self._source.topics())

    def finish(self) -> tuple[str, ...]:
        """Close the bag; returns what is not in it, in words."""
        recording, self._recording = self._recording, None
        assert recording is not None
        self._chronicle.detach()
        recording.close()
        self._closed_view = recording.view()
        return (*recording.remarks(), *self._losses())

    def _losses(self) -> Iterator[str]:
        for topic, count in self._lost().items():
            if lost := count - self._lost_before.get(topic, 0):
                yield f"{topic}: {lost} messages were lost on the way"

    def _lost(self) -> dict[str, int]:
        """Messages lost on the way since the source was opened, where that is known."""
        return {status.topic: status.lost or 0 for status in self._source.status()}

    def view(self) -> RecorderView:
        """As screens show it."""
        return self._recording.view() if self._recording else self._closed_view

    def dropped(self) -> dict[str, int]:
        """Messages dropped from the recording that is open, by topic."""
        return self._recording.dropped() if self._recording else {}
