"""What is said and done: the journal on disk, the log for people, the topics for robot and bag."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence

from msgspec.structs import replace

from madrob_console.engine.live.equipment import Equipment
from madrob_console.engine.live.event_log import EventLog
from madrob_console.engine.live.journal_keeper import JournalKeeper, OpenJournal, Promise
from madrob_console.engine.live.recording import Recording
from madrob_console.messages.codec import (
    REFEREE_EVENT_TOPIC,
    REFEREE_START_POSE_TOPIC,
    REFEREE_STATE_TOPIC,
    encode_start_pose,
    encode_text,
    referee_topics,
)
from madrob_console.referee.journal import Entry
from madrob_console.referee.on_record import JournalMark
from madrob_console.referee.run import Run
from recorder.message import RawMessage
from scoring.protocol import StartPose


class Chronicle:
    """Keeps the records of one run after the other.

    Args:
        equipment: what the engine works with.

    Attributes:
        log: the last lines, for people.
    """

    def __init__(self, equipment: Equipment) -> None:
        self.log = EventLog()
        self._source = equipment.source
        self._clock = equipment.clock
        self._types = types = equipment.types
        self._type_names = {topic.name: topic.type for topic in referee_topics(types)}
        self._lines = JournalKeeper(equipment.keepers.own, equipment.keepers.monotonic)
        self._recording: Recording | None = None
        self._early: list[RawMessage] = []

    @property
    def entries(self) -> tuple[Entry, ...]:
        """Every line of the run at hand, on disk or not."""
        return self._lines.entries

    @property
    def mark(self) -> JournalMark:
        """The mark of all these lines."""
        return self._lines.mark

    @property
    def full(self) -> bool:
        """Whether the journal takes only what ends the run and its result."""
        return self._lines.full

    @property
    def problem(self) -> str | None:
        """Why the disk refuses lines of the journal, in words; None when it does not."""
        return self._lines.problem

    @property
    def unwritten(self) -> tuple[int, float]:
        """How many lines are not on disk, and for how long, s. From any thread."""
        return self._lines.unwritten

    def begin(self) -> None:
        """A new run is set up; its journal waits for its folder."""
        self._lines.begin()
        self.log.clear()
        self._recording = None
        self._early = []

    def attach(self, recording: Recording, journal: OpenJournal, entries: Sequence[Entry]) -> None:
        """Go on in the run's folder and its bag.

        Args:
            recording: gets what was said so far.
            journal: of the run.
            entries: the lines that it has.
        """
        self._lines.adopt(journal, entries)
        self._recording = recording
        now_ns = self._clock.now_ns()
        self._record([replace(message, receive_ns=now_ns) for message in self._early])
        self._early = []

    def go_on(self, journal: OpenJournal, entries: Sequence[Entry]) -> None:
        """Put the run at hand away and go on with the journal of an earlier one."""
        self.begin()
        self._lines.adopt(journal, entries)

    def detach(self) -> None:
        """The bag is about to be closed; the journal goes on."""
        self._recording = None

    def close(self) -> None:
        """Close the journal."""
        self._lines.close()

    def write(self, entry: Entry, start: float | None) -> None:
        """Write a line to journal, log, topic and bag; where the disk does not take it, it waits.

        Args:
            entry: the line.
            start: of the run, s since the epoch, for the log; None outside a run.
        """
        self._lines.add(entry)
        self.say(entry, start)

    def promise(self, promise: Promise, done: Callable[[str | None], None]) -> None:
        """Write a line to the journal alone; `say` the rest when it takes effect.

        Args:
            promise: the line.
            done: as for `JournalKeeper.promise`.
        """
        self._lines.promise(promise, done)

    def say(self, entry: Entry, start: float | None) -> None:
        """Write a line to log, topic and bag; arguments as for `write`."""
        self.log.add(entry, start)
        self._say(REFEREE_EVENT_TOPIC, encode_text(self._types, entry.to_json()))

    def catch_up(self) -> None:
        """Try again to write what waits; a journal that was deleted is written anew."""
        self._lines.catch_up()

    def announce_state(self, run: Run) -> None:
        """Tell robot and testbed where the run stands (`/madrob/referee/state`)."""
        setup = run.setup
        condition = setup.condition if setup else None
        content = {
            "phase": run.phase,
            "subject": setup.subject if setup else None,
            "team": setup.team if setup else None,
            "run_number": setup.run_number if setup else None,
            "run_id": setup.run_id if setup else None,
            "testbed": setup.testbed if setup else None,
            "condition_number": condition.number if condition else None,
            "benchmark_type": condition.benchmark_type if condition else None,
            "opening_side": condition.opening_side if condition else None,
            "starting_side": condition.starting_side if condition else None,
            "start_time": run.start,
            "timeout": setup.timeout if setup else None,
            "outcome": run.outcome,
            "void": run.voided is not None,
        }
        self._say(REFEREE_STATE_TOPIC, encode_text(self._types, json.dumps(content)))

    def announce_start_pose(self, pose: StartPose) -> None:
        """Tell the robot where it starts (`/madrob/referee/start_pose`)."""
        data = encode_start_pose(self._types, pose, self._clock.now_ns())
        self._say(REFEREE_START_POSE_TOPIC, data)

    def _say(self, topic: str, data: bytes) -> None:
        """Publish a message of the console's own, and record it."""
        now_ns = self._clock.now_ns()
        message = RawMessage(topic, self._type_names[topic], data, now_ns, now_ns)
        self._source.publish(message)
        self._record([message])

    def _record(self, messages: Sequence[RawMessage]) -> None:
        if self._recording is None:
            self._early.extend(messages)  # said before the bag is open: recorded when it is
            return
        self._recording.put(messages)
