"""A testbed whose topics can be spoiled while it runs."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path

from msgspec import structs

from madrob_console.archive import score
from madrob_console.common.clock import Clock
from madrob_console.common.names import SourceKind
from madrob_console.engine.core import Engine
from madrob_console.messages.message_types import MessageTypes
from madrob_console.referee.acts import ConfirmPose, SetUp, Start, ZeroHandle
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from madrob_console.testbeds.source import Announcement, BeginAbort, Source, TopicStatus
from recorder.bag import RawMessage, Topic
from recorder.reader import read_bag
from scoring.protocol import Condition
from scoring.result import Result
from tests.madrob_console.engine.drive import STEP, OfficialDrive, make_setup
from tests.madrob_console.engine.spoilt import Edit, Fault, Spoil, edited, spoiler

TIMEOUT = 16.0
"""Of a run, s; the robot needs 13.85 s."""


class FaultySource(Source):
    """A simulated testbed, honest until told otherwise.

    Attributes:
        handed: every message handed to the engine, in order.
        published: every message that the engine published, in order.
        second_referee: who else publishes the state of the run, in words.
        simulated_time: see `Announcement`.
    """

    def __init__(self, source: SimulatedSource, clock: Clock) -> None:
        self.handed: list[RawMessage] = []
        self.published: list[RawMessage] = []
        self.second_referee: str | None = None
        self.simulated_time: float | None = None
        self._source = source
        self._clock = clock
        self._spoils: dict[str, Spoil] = {}
        self._publishers: dict[str, int] = {}
        self._coming: list[RawMessage] = []
        self._deliver: Callable[[int], int] = lambda at: at

    def spoil(self, topic: str, fault: Fault) -> None:
        """From now on `topic` is faulty."""
        self._publishers[topic] = 2 if fault is Fault.TWO_PUBLISHERS else 1
        self._spoils[topic] = spoiler(topic, fault)

    def fake(self, topic: str, edit: Edit) -> None:
        """From now on `topic` says something else."""
        self._spoils[topic] = lambda message: [edited(message, edit)]

    def alternate(self, topic: str, faults: Sequence[Fault]) -> None:
        """From now on each message of `topic` has the next one of these faults."""
        spoils = cycle([spoiler(topic, fault) for fault in faults])

        def spoil(message: RawMessage) -> list[RawMessage]:
            return next(spoils)(message)

        self._spoils[topic] = spoil

    def replace_data(self, topic: str, data: Sequence[bytes]) -> None:
        """From now on `topic` sends these bytes, again and again; nothing if there are none."""
        again = cycle(data)
        self._spoils[topic] = lambda message: [
            structs.replace(message, data=d) for d in islice(again, 1)
        ]

    def deliver(self, when: Callable[[int], int]) -> None:
        """From now on what would come at a time, ns since the epoch, comes at another one."""
        self._deliver = when

    def heal(self, topic: str) -> None:
        """From now on `topic` is honest again."""
        self._spoils.pop(topic, None)
        self._publishers.pop(topic, None)

    def take_messages(self, timeout: float) -> list[RawMessage]:
        for message in self._source.take_messages(timeout):
            spoil = self._spoils.get(message.topic)
            came = structs.replace(message, receive_ns=self._deliver(message.receive_ns))
            self._coming += [came] if spoil is None else spoil(came)
        self._coming.sort(key=lambda message: message.receive_ns)
        now = self._clock.now_ns()
        taken = [m for m in self._coming if m.receive_ns <= now]
        self._coming = self._coming[len(taken) :]
        self.handed += taken
        return taken

    def status(self) -> Sequence[TopicStatus]:
        return tuple(self._spoiled_status(s) for s in self._source.status())

    def _spoiled_status(self, status: TopicStatus) -> TopicStatus:
        publishers = self._publishers.get(status.topic, status.publishers)
        return replace(status, publishers=publishers, lost=None if publishers > 1 else 0)

    @property
    def kind(self) -> SourceKind:
        return self._source.kind

    @property
    def label(self) -> str:
        return self._source.label

    @property
    def sides_problem(self) -> str | None:
        return self._source.sides_problem

    @property
    def announcement(self) -> Announcement:
        return replace(self._source.announcement, simulated_time=self.simulated_time)

    def offer_abort(self, begin_abort: BeginAbort) -> None:
        self._source.offer_abort(begin_abort)

    @property
    def other_referee(self) -> str | None:
        return self.second_referee

    def open(self) -> None:
        self._source.open()

    def topics(self) -> Sequence[Topic]:
        return self._source.topics()

    def configure(self, condition: Condition) -> None:
        self._source.configure(condition)

    def publish(self, message: RawMessage) -> None:
        self.published.append(message)
        self._source.publish(message)

    def close(self) -> None:
        self._source.close()


class FaultyDrive(OfficialDrive):
    """A drive on a testbed that can be spoiled; its runs count."""

    SPOILT = FaultySource

    def __init__(self, results: Path) -> None:
        super().__init__(results)
        self.faulty = self.SPOILT(self.source, self.clock)
        self.engine = Engine(self.faulty, self.clock, self.engine.config, MessageTypes())
        self.engine.open()

    def set_up(self) -> None:
        """All is ready for a start."""
        self.act(SetUp(make_setup(timeout=TIMEOUT, countdown=1.0)))
        self.wait(2.1)
        self.act(ZeroHandle(), ConfirmPose())

    def spoilt_run(self, topic: str, fault: Fault) -> None:
        """A run that goes well for 3 s: the handle is touched, the door begins to open."""
        self.set_up()
        self.begin()
        self.wait(4.0)
        assert (self.engine.run.phase, self.faults()) == (Phase.RUNNING, "")
        self.faulty.spoil(topic, fault)

    def result(self) -> Result:
        """The run's result, waited for."""
        self.finish()
        assert self.engine.scored is not None
        return self.engine.scored.result

    def rescored(self) -> Result:
        """What `madrob score` says of the run."""
        assert self.engine.folder is not None
        return next(score(self.engine.folder)).result

    def recorded(self, topic: str) -> list[bytes]:
        """What the bag holds of a topic."""
        assert self.engine.folder is not None
        return [m.data for m in read_bag(self.engine.folder).messages() if m.topic == topic]

    def topics(self) -> list[str]:
        """The topics that a testbed must have."""
        return [view.topic for view in self.engine.snapshot().topics if not view.optional]

    def begin(self) -> None:
        """Start, and count from here what is handed to the engine: all of it is recorded."""
        self.act(Start())
        self.faulty.handed.clear()

    def handed(self, topic: str) -> list[bytes]:
        """What came on a topic since the recording began."""
        return [message.data for message in self.faulty.handed if message.topic == topic]

    def seen_after(self, texts: Callable[[], str], words: str, patience: float = 2.0) -> float:
        """How long it takes until a text holds these words (a pattern), s."""
        begin = self.engine.now()
        while not re.search(words, texts()):
            assert self.engine.now() - begin <= patience, f"{words!r} is not in {texts()!r}"
            self.engine.step(STEP)
        return self.engine.now() - begin

    def faults(self) -> str:
        """The fault lines."""
        return "\n".join(self.engine.snapshot().all_faults)
