"""The recording of the run at hand, from its start to the end of its post-roll."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial

from msgspec.structs import replace as changed

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.archive.run_record import RunRecord
from madrob_console.engine.live.chronicle import Chronicle
from madrob_console.engine.live.equipment import Equipment
from madrob_console.engine.live.journal_keeper import OpenJournal, Promise
from madrob_console.engine.live.recording import Recording
from madrob_console.engine.live.witness import EvidencePlace, Witness
from madrob_console.engine.shown.snapshot import RecorderView
from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind
from madrob_console.referee.evidence_account import EvidenceAccount
from madrob_console.referee.journal import Entry
from madrob_console.referee.run import Run
from madrob_console.referee.transitions import begin_countdown
from recorder.message import RawMessage
from recorder.stats import BagSummary

COUNTING = 0.5
"""The result waits no longer than this until all of the evidence is counted, s."""

_NO_FOLDER = EvidenceAccount(
    problems=("nothing was recorded: the run's folder could not be opened a second time",)
)


@dataclass(frozen=True, slots=True, eq=False)
class OpenRecording:
    """What was made for a run that starts.

    Attributes:
        record: what is set for it.
        recording: its folder and its bag.
        journal: with its first lines.
        entries: these lines, the start being the last.
    """

    record: RunRecord
    recording: Recording
    journal: OpenJournal
    entries: Sequence[Entry]

    def give_up(self, withdrawal: Entry) -> None:
        """Close it: the run does not start. Its folder stays, its number is used."""
        self.journal.append([withdrawal], again=False)
        self.journal.close()
        self.recording.close()


class RunRecorder:
    """Opens and closes the recording of one run after the other, and knows what it lacks.

    Args:
        equipment: what the engine works with.
        chronicle: writes into the run's folder and its bag, too.
    """

    def __init__(self, equipment: Equipment, chronicle: Chronicle) -> None:
        self._source = equipment.source
        self._config = equipment.config
        self._chronicle = chronicle
        self._keepers = equipment.keepers
        self._clock = equipment.clock
        self._witness = equipment.witness
        self._room = equipment.room
        self._recording: Recording | None = None
        self._closing: Recording | None = None
        self._closed_view = RecorderView("closed")
        self._lost_before: dict[str, int] = {}
        self._has_evidence = False

    @property
    def recording(self) -> bool:
        """Whether messages are recorded."""
        return self._recording is not None

    @property
    def open(self) -> bool:
        """Whether a bag is open: one that is being closed, too."""
        return self._recording is not None or self._closing is not None

    def clear(self) -> None:
        """Nothing is to be said any more of the recording before."""
        self._closed_view = RecorderView("closed")

    def start(
        self, run: Run, promise: Promise, done: Callable[[Future[OpenRecording | None]], None]
    ) -> Future[OpenRecording | None]:
        """Have a run's folder, bag and journal made; nothing is recorded yet.

        Args:
            run: as it is set up.
            promise: the line of its start.
            done: told what came of it: what is open now, None if it was withdrawn, or a
                `MadrobError` that names the remedy.

        Returns:
            The same.
        """
        assert run.setup is not None
        config, entry, told = self._config, promise.entry, self._source.announcement
        record = RunRecord(
            setup=run.setup,
            handle_zero=run.handle_zero,
            thresholds=config.thresholds,
            mappings=config.mappings,
            source=self._source.kind if told.simulated is None else SourceKind.SIMULATED,
            competition=config.competition,
            version=config.version,
            zero_samples=run.zero_samples,
        )
        start = begin_countdown(run, entry.time).start
        assert start is not None
        make = partial(
            Recording,
            config.results,
            record,
            start,
            self._source.topics(),
            lossless=config.lossless,
            reading=self._keepers.reading,
            evidence=self._witness.status is not None,
        )
        entries = (*self._chronicle.entries, entry)
        return self._keepers.own.ask(partial(_open, record, make, entries, promise), done)

    def adopt(self, opened: OpenRecording, now_ns: int) -> None:
        """Record from now on; what the testbed said of itself is recorded, too."""
        self._chronicle.attach(opened.recording, opened.journal, opened.entries)
        self._recording = opened.recording
        for told in self._source.announcement.messages:
            self._recording.add_topics(self._source.topics())
            self.put([changed(told, receive_ns=now_ns)])  # said before the bag was open
        self._lost_before = self._lost()
        folder = opened.recording.take_evidence_folder()
        self._has_evidence = folder is not None
        if folder is not None:
            place = EvidencePlace(
                folder,
                opened.recording.folder.name,
                self._clock.now_ns(),
                time.monotonic_ns(),
                most_bytes=self._room.budget_left,
                least_free=self._config.disk_needed,
            )
            self._witness.begin(place)

    def put(self, messages: Iterable[RawMessage]) -> None:
        """Record messages if a bag is open."""
        if self._recording is not None:
            self._recording.put(messages)

    def look(self) -> None:
        """Record topics that appeared late, too."""
        if self._recording is not None:
            self._recording.add_topics(self._source.topics())

    def finish(self, done: Callable[[tuple[str, ...], int], None]) -> None:
        """Have the bag closed; nothing more is recorded.

        Args:
            done: told when it is: what is not in it, in words, and how many messages of that were
                scored.
        """
        recording = self._closing = self._recording
        assert recording is not None
        self._recording = None
        self._witness.end()
        self._chronicle.detach()
        losses = tuple(self._losses())

        def closed(_answer: Future[BagSummary]) -> None:
            self._closing, self._closed_view = None, recording.view()
            done((*recording.remarks(), *losses), recording.unrecorded)

        self._keepers.own.ask(partial(_close, recording, self._witness), closed)

    def _losses(self) -> Iterator[str]:
        for topic, count in self._lost().items():
            if lost := count - self._lost_before.get(topic, 0):
                yield f"{topic}: {lost} messages were lost on the way"

    def _lost(self) -> dict[str, int]:
        """Messages lost on the way since the source was opened, where that is known."""
        return {status.topic: status.lost or 0 for status in self._source.status()}

    @property
    def silent(self) -> float:
        """How long the disk has taken nothing of what is recorded, s. From any thread."""
        recording = self._recording or self._closing
        return 0.0 if recording is None else recording.silent

    def evidence(self, start: float) -> EvidenceAccount | None:
        """What was recorded beside the testbed's topics; None = nothing is wanted.

        Args:
            start: of the run, s since the epoch.
        """
        status = self._witness.status
        if status is None:
            return None
        if not self._has_evidence:
            return _NO_FOLDER
        return status.account_since(start)

    def view(self) -> RecorderView:
        """As screens show it."""
        recording = self._recording or self._closing
        return recording.view() if recording else self._closed_view

    def dropped(self) -> dict[str, int]:
        """Messages dropped from the recording that goes on, by topic."""
        return self._recording.dropped() if self._recording else {}


def _close(recording: Recording, witness: Witness) -> BagSummary:
    """Close the bag; the evidence is counted to its end meanwhile, or nearly so."""
    summary = recording.close()
    witness.await_account(COUNTING)
    return summary


def _open(
    record: RunRecord,
    make: Callable[[], Recording],
    entries: Sequence[Entry],
    promise: Promise,
) -> OpenRecording | None:
    """Make folder, bag and journal; None if the start was withdrawn meanwhile.

    Raises:
        MadrobError: the disk refuses; the message names the remedy.
    """
    recording = make()
    try:
        journal = OpenJournal.create(recording.folder / JOURNAL_FILE, entries)
    except MadrobError:
        recording.close()
        raise
    opened = OpenRecording(record, recording, journal, entries)
    if promise.keep():
        return opened
    assert promise.withdrawal is not None
    opened.give_up(promise.withdrawal)
    return None
