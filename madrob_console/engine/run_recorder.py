"""Records the current run and publishes its events: bag, topic, journal, log."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from functools import partial

from msgspec.structs import replace

from madrob_console.archive.run_record import RunRecord
from madrob_console.common.names import SourceKind, terminal_safe
from madrob_console.engine.evidence_client import EvidenceClient, EvidencePlace
from madrob_console.engine.journal_writer import JournalKeeper, JournalLine, Recording
from madrob_console.engine.public_state import PublishedState
from madrob_console.engine.replay import EngineContext
from madrob_console.engine.snapshot import LogLine, RecorderView, Weight
from madrob_console.messages.codec import (
    REFEREE_EVENT_TOPIC,
    REFEREE_START_POSE_TOPIC,
    REFEREE_STATE_TOPIC,
    encode_start_pose,
    encode_text,
    referee_topics,
)
from madrob_console.referee.acts import Act
from madrob_console.referee.evidence_account import EvidenceAccount
from madrob_console.referee.journal import Entry
from madrob_console.referee.rebuild import Change, act_of
from madrob_console.referee.run import Run, begin_countdown
from recorder.bag import RawMessage
from scoring.protocol import StartPose, event_words

# The event log that people read: the last lines, numbered.


KEPT_LINES = 200


class EventLog:
    """Numbers lines from 0 over the life of the engine and keeps the last 200."""

    def __init__(self) -> None:
        self._lines: deque[LogLine] = deque(maxlen=KEPT_LINES)
        self._number = 0

    @property
    def lines(self) -> tuple[LogLine, ...]:
        """Oldest first."""
        return tuple(self._lines)

    def clear(self) -> None:
        self._lines.clear()

    def add_line(self, entry: Entry, start: float | None) -> None:
        """`start` of the run is in s since the epoch."""
        time = float(entry.details.get("time", entry.time))
        relative = None if start is None else time - start
        act = act_of(entry)
        words, weight = _said(entry) if act is None else _done(act)
        text = terminal_safe(f"{words}: {entry.reason}" if entry.reason else words)
        self._lines.append(LogLine(self._number, time, relative, entry.origin, text, weight))
        self._number += 1


def _said(entry: Entry) -> tuple[str, Weight]:
    match entry.what:
        case Change.EVENT:
            return event_words(str(entry.details["event"])), Weight.PLAIN
        case Change.FALSE_START:
            return f"FALSE START: {event_words(str(entry.details['event']))}", Weight.ALARM
        case Change.WITHDRAWN:
            return f"{entry.details.get('act', 'a line')} withdrawn", Weight.NOTICE
        case Change.RUN_STOPS:
            return f"run stops: {entry.details['outcome']}", Weight.PLAIN
    return entry.what, Weight.PLAIN


def _done(act: Act) -> tuple[str, Weight]:
    return act.logged, Weight.NOTICE if act.stands_out else Weight.PLAIN


# The publisher of events: journal on disk, log for people, topics for robot and bag.


class EventPublisher:
    """Keeps the journal, log, topic and bag of one run after the other.

    Attributes:
        recording: what is recorded now.
    """

    def __init__(self, engine_context: EngineContext) -> None:
        self.log = EventLog()
        self._source = engine_context.source
        self._clock = engine_context.clock
        self._types = types = engine_context.types
        self._type_names = {topic.name: topic.type for topic in referee_topics(types)}
        keepers = engine_context.keepers
        self.journal = JournalKeeper(keepers.own, keepers.monotonic)
        self.recording: Recording | None = None
        self._early: list[RawMessage] = []

    def begin_run(self) -> None:
        self.journal.begin_journal()
        self.log.clear()
        self.recording = None
        self._early = []

    def attach(self, recording: Recording) -> None:
        self.journal.adopt(recording.journal, recording.entries)
        self.recording = recording
        now_ns = self._clock.now_ns()
        recording.record_messages([replace(early, receive_ns=now_ns) for early in self._early])
        self._early = []

    def write(self, entry: Entry, start: float | None) -> None:
        """Write a line to journal, log, topic and bag; if the disk refuses it, it waits.

        `start` of the run is in s since the epoch.
        """
        self.journal.add_line(JournalLine(entry))
        self.say(entry, start)

    def say(self, entry: Entry, start: float | None) -> None:
        self.log.add_line(entry, start)
        self._say(REFEREE_EVENT_TOPIC, encode_text(self._types, entry.to_json()))

    def announce_state(self, run: Run) -> None:
        """Tell robot and testbed the state of the run (`/madrob/referee/state`)."""
        self._say(REFEREE_STATE_TOPIC, encode_text(self._types, PublishedState.of(run).text))

    def announce_start_pose(self, pose: StartPose) -> None:
        """Tell the robot where it starts (`/madrob/referee/start_pose`)."""
        data = encode_start_pose(self._types, pose, self._clock.now_ns())
        self._say(REFEREE_START_POSE_TOPIC, data)

    def _say(self, topic: str, data: bytes) -> None:
        now_ns = self._clock.now_ns()
        message = RawMessage(topic, self._type_names[topic], data, now_ns, now_ns)
        self._source.publish(message)
        if self.recording is None:
            self._early.append(message)  # said before the bag is open: recorded when it is
        else:
            self.recording.record_messages([message])


COUNTING = 0.5
"""The result waits at most this long for all of the evidence to be counted, s."""


class RunRecorder:
    """Opens and closes the recording of one run after the other, and knows what is missing."""

    def __init__(self, engine_context: EngineContext, event_publisher: EventPublisher) -> None:
        self._source = engine_context.source
        self._config = engine_context.config
        self._event_publisher = event_publisher
        self._keepers = engine_context.keepers
        self._clock = engine_context.clock
        self._evidence_client = engine_context.evidence_client
        self._room = engine_context.room
        self._last: Recording | None = None
        self._closing = False
        self._lost_before: dict[str, int] = {}

    @property
    def recording(self) -> bool:
        return self._event_publisher.recording is not None

    @property
    def open(self) -> bool:
        return self.recording or self._closing

    def clear(self) -> None:
        self._last = None

    def start(
        self, run: Run, line: JournalLine, done: Callable[[Future[Recording | None]], None]
    ) -> Future[Recording | None]:
        """Have a run's folder, bag and journal made; nothing is recorded yet.

        The answer, also for `done`, is the open recording; None if its start was withdrawn.
        """
        assert run.setup is not None
        config, entry, told = self._config, line.entry, self._source.announcement
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
            (*self._event_publisher.journal.entries, entry),
            lossless=config.lossless,
        )
        return self._keepers.own.submit_job(partial(_open, make, line), done)

    def adopt(self, recording: Recording, now_ns: int) -> None:
        """Record from now on, including what the testbed said of itself."""
        self._event_publisher.attach(recording)
        self._last = recording
        for told in self._source.announcement.messages:
            recording.add_topics(self._source.topics())
            self.record_messages([replace(told, receive_ns=now_ns)])  # said before the bag was open
        self._lost_before = self._lost()
        if self._evidence_client.status is not None:
            place = EvidencePlace(
                str(recording.folder.absolute()),
                self._clock.now_ns(),
                time.monotonic_ns(),
                most_bytes=self._room.budget_left,
                least_free=self._config.disk_needed,
            )
            self._evidence_client.begin_recording(place)

    def record_messages(self, messages: Iterable[RawMessage]) -> None:
        """Does nothing without an open bag."""
        if self._event_publisher.recording is not None:
            self._event_publisher.recording.record_messages(messages)

    def record_late_topics(self) -> None:
        if self._event_publisher.recording is not None:
            self._event_publisher.recording.add_topics(self._source.topics())

    def finish(self, done: Callable[[tuple[str, ...], int], None]) -> None:
        """Have the bag closed; nothing more is recorded.

        `done` then gets in words what is missing, and how many messages of that were scored.
        """
        recording = self._event_publisher.recording
        assert recording is not None
        self._event_publisher.recording, self._closing = None, True
        self._evidence_client.end_recording()
        losses = tuple(self._losses())

        def closed(_answer: Future[None]) -> None:
            self._closing = False
            done((*recording.remarks(), *losses), recording.unrecorded)

        self._keepers.own.submit_job(partial(_close, recording, self._evidence_client), closed)

    def _losses(self) -> Iterator[str]:
        for topic, count in self._lost().items():
            if lost := count - self._lost_before.get(topic, 0):
                yield f"{topic}: {lost} messages were lost on the way"

    def _lost(self) -> dict[str, int]:
        return {status.topic: status.lost or 0 for status in self._source.status()}

    @property
    def silent(self) -> float:
        """How long the disk has taken nothing of the recording, s. From any thread."""
        last = self._last if self.open else None
        return 0.0 if last is None else last.silent

    def evidence(self, start: float) -> EvidenceAccount | None:
        """Account of the evidence; None = none is wanted. `start` is in s since the epoch."""
        status = self._evidence_client.status
        return None if status is None else status.account_since(start)

    def view(self) -> RecorderView:
        return RecorderView("closed") if self._last is None else self._last.view()

    def dropped(self) -> dict[str, int]:
        recording = self._event_publisher.recording
        return {} if recording is None else recording.dropped()


def _close(recording: Recording, evidence_client: EvidenceClient) -> None:
    recording.close()
    evidence_client.await_account(COUNTING)


def _open(make: Callable[[], Recording], line: JournalLine) -> Recording | None:
    recording = make()
    if line.keep():
        return recording
    assert line.withdrawal is not None
    recording.give_up(line.withdrawal)
    return None
