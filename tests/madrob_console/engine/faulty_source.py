"""A testbed whose topics can be spoiled while it runs."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from msgspec import structs

from madrob_console.archive import score
from madrob_console.common.names import SourceKind
from madrob_console.referee.acts import ConfirmPose, SetUp, Start, ZeroHandle
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from madrob_console.testbeds.source import Announcement, TopicStatus
from recorder.bag import RawMessage
from recorder.reader import Bag
from scoring.result import Result
from tests.madrob_console.engine.drive import STEP, Drive, make_setup
from tests.madrob_console.engine.spoilt import Edit, Fault, Spoil, edited, spoiler

TIMEOUT = 16.0
"""Of a run, s; the robot needs 13.85 s."""


class FaultySource(SimulatedSource):
    """A simulated testbed as good as a real one, honest until told otherwise.

    Attributes:
        handed: every message handed to the engine, in order.
        published: every message that the engine published, in order.
        other_referee: who else publishes the state of the run, in words.
        simulated_time: see `Announcement`.
    """

    kind = SourceKind.ROS
    other_referee: str | None = None
    simulated_time: float | None = None

    def __init__(self, *testbed: Any, **more: Any) -> None:  # noqa: ANN401  of the simulated one
        super().__init__(*testbed, **more)
        self.handed: list[RawMessage] = []
        self.published: list[RawMessage] = []
        self._spoils: dict[str, Spoil] = {}
        self._doubled: set[str] = set()
        self._coming: list[RawMessage] = []
        self._deliver: Callable[[int], int] = lambda at: at

    def spoil(self, topic: str, fault: Fault) -> None:
        """From now on `topic` is faulty."""
        self.send(topic, spoiler(topic, fault))
        if fault is Fault.TWO_PUBLISHERS:
            self._doubled.add(topic)

    def fake(self, topic: str, edit: Edit) -> None:
        """From now on `topic` says something else."""
        self.send(topic, lambda message: [edited(message, edit)])

    def send(self, topic: str, spoil: Spoil) -> None:
        """From now on this comes instead of each message of `topic`."""
        self.heal(topic)
        self._spoils[topic] = spoil

    def deliver(self, when: Callable[[int], int]) -> None:
        """From now on what would come at a time, ns since the epoch, comes at another one."""
        self._deliver = when

    def heal(self, topic: str) -> None:
        """From now on `topic` is honest again."""
        self._spoils.pop(topic, None)
        self._doubled.discard(topic)

    def take_messages(self, timeout: float) -> list[RawMessage]:
        for message in super().take_messages(timeout):
            came = structs.replace(message, receive_ns=self._deliver(message.receive_ns))
            spoil = self._spoils.get(message.topic)
            self._coming += [came] if spoil is None else spoil(came)
        self._coming.sort(key=lambda message: message.receive_ns)
        now = self._clock.now_ns()
        taken = [m for m in self._coming if m.receive_ns <= now]
        self._coming = self._coming[len(taken) :]
        self.handed += taken
        return taken

    def status(self) -> Sequence[TopicStatus]:
        return tuple(
            replace(one, publishers=2, lost=None)
            if one.topic in self._doubled
            else replace(one, lost=0)
            for one in super().status()
        )

    @property
    def announcement(self) -> Announcement:
        return Announcement(simulated_time=self.simulated_time)

    def publish(self, message: RawMessage) -> None:
        self.published.append(message)
        super().publish(message)


class FaultyDrive(Drive):
    """A drive on a testbed that can be spoiled; its runs count."""

    SPOILT = FaultySource

    def __init__(self, results: Path, *, lossless: bool = True) -> None:
        self.SOURCE = self.SPOILT
        super().__init__(results, lossless=lossless)

    @property
    def faulty(self) -> FaultySource:
        assert isinstance(self.source, FaultySource)
        return self.source

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
        return [m.data for m in Bag(self.engine.folder).messages() if m.topic == topic]

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
