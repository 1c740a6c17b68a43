"""What is said and done: the journal on disk, the log for people, the topics for robot and bag."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from msgspec.structs import replace

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.clock import Clock
from madrob_console.engine.live.event_log import EventLog
from madrob_console.engine.live.recording import Recording
from madrob_console.errors import MadrobError
from madrob_console.messages.codec import (
    REFEREE_EVENT_TOPIC,
    REFEREE_START_POSE_TOPIC,
    REFEREE_STATE_TOPIC,
    MessageTypes,
    encode_start_pose,
    encode_text,
    referee_topics,
)
from madrob_console.referee.journal import Entry, Journal, up_to_date
from madrob_console.referee.run import Run
from madrob_console.testbeds.source import Source
from recorder.message import RawMessage
from scoring.protocol import StartPose


class Chronicle:
    """Keeps the records of one run after the other.

    Args:
        source: publishes what is said.
        clock: stamps it.
        types: the message types.

    Attributes:
        log: the last lines, for people.
        problem: why the journal is not on disk, in words; None when it is.
    """

    def __init__(self, source: Source, clock: Clock, types: MessageTypes) -> None:
        self.log = EventLog()
        self.problem: str | None = None
        self._source = source
        self._clock = clock
        self._types = types
        self._type_names = {topic.name: topic.type for topic in referee_topics(types)}
        self._journal = Journal()
        self._path: Path | None = None
        self._entries: list[Entry] = []
        self._recording: Recording | None = None
        self._early: list[RawMessage] = []

    @property
    def entries(self) -> tuple[Entry, ...]:
        """Every line of the run at hand."""
        return tuple(self._entries)

    def begin(self) -> None:
        """A new run is set up; its journal waits for its folder."""
        self.close()
        self._journal = Journal()
        self._path, self._entries = None, []
        self.log.clear()
        self.problem = None
        self._early = []

    def attach(self, recording: Recording) -> None:
        """Write what was said so far into the run's folder and its bag, and go on there.

        Raises:
            MadrobError: the folder refuses.
        """
        path = recording.folder / JOURNAL_FILE
        try:
            self._journal.open(path)
        except OSError as error:
            self._journal.close()
            raise MadrobError(f"{path}: cannot be written ({error.strerror})") from None
        self._path, self._recording = path, recording
        now_ns = self._clock.now_ns()
        self._record([replace(message, receive_ns=now_ns) for message in self._early])
        self._early = []

    def reopen(self, folder: Path, entries: Sequence[Entry]) -> None:
        """Put the run at hand away and go on with the journal of an earlier one.

        Args:
            folder: the run's folder.
            entries: its journal so far; written down where the folder has none.

        Raises:
            MadrobError: another program writes it, or the folder refuses.
        """
        path, journal = folder / JOURNAL_FILE, Journal()
        try:
            try:
                journal.reopen(path)
            except FileNotFoundError:
                for entry in entries:
                    journal.append(entry, must_take_effect=True)
                journal.open(path)
        except BlockingIOError:
            raise MadrobError(f"{folder.name}: another console works on this run") from None
        except OSError as error:
            raise MadrobError(
                f"{path}: cannot be written ({error.strerror}); `madrob score` reads such a run"
            ) from None
        self.begin()
        self._journal, self._path, self._entries = journal, path, list(entries)

    def detach(self) -> None:
        """The bag is about to be closed; the journal goes on."""
        self._recording = None

    def close(self) -> None:
        """Close the journal."""
        self._journal.close()

    def write(self, entry: Entry, start: float | None, *, must_take_effect: bool) -> None:
        """Write a line to journal, log, topic and bag.

        Args:
            entry: the line.
            start: of the run, s since the epoch, for the log; None outside a run.
            must_take_effect: as for `Journal.append`.

        Raises:
            MadrobError: the line cannot be written and need not take effect.
        """
        self.problem = self._journal.append(entry, must_take_effect=must_take_effect)
        self._entries.append(entry)
        if self._deleted():
            self._renew()
        self.log.add(entry, start)
        self._say(REFEREE_EVENT_TOPIC, encode_text(self._types, entry.to_json()))

    def catch_up(self) -> None:
        """Try again to write what waits; a journal that was deleted is written anew."""
        if not self._deleted():
            self.problem = self._journal.flush()
        if self._deleted() or self.problem is not None:
            self._renew()

    def _deleted(self) -> bool:
        return self._path is not None and not os.path.lexists(self._path)

    def _renew(self) -> None:
        """Go on in a new file, or in the one that is there when the disk has come back."""
        assert self._path is not None
        try:
            journal = up_to_date(self._path, self._entries)
        except (OSError, MadrobError) as error:
            why = error.strerror if isinstance(error, OSError) else error
            self.problem = self.problem or f"the journal was deleted, a new one is refused ({why})"
            return
        self._journal.close()
        self._journal, self.problem = journal, None

    def announce_state(self, run: Run) -> None:
        """Tell robot and testbed where the run stands (`/madrob/referee/state`)."""
        setup = run.setup
        condition = setup.condition if setup else None
        content = {
            "phase": run.phase,
            "subject": setup.subject if setup else None,
            "team": setup.team if setup else None,
            "run_number": setup.run_number if setup else None,
            "condition_number": condition.number if condition else None,
            "benchmark_type": condition.benchmark_type if condition else None,
            "opening_side": condition.opening_side if condition else None,
            "starting_side": condition.starting_side if condition else None,
            "start_time": run.start,
            "timeout": setup.timeout if setup else None,
            "outcome": run.outcome,
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
        for message in messages:
            self._recording.put(message)
