"""The one driver of a run: the real engine inline in virtual time, on a simulated testbed.

The testbed can be spoilt while it runs, and a recorded run gone through once more.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from pathlib import Path
from random import Random
from typing import Any

from msgspec import structs

from madrob_console.archive import score
from madrob_console.archive.appeal import EQUAL
from madrob_console.archive.scored import Scored, score_opened
from madrob_console.common.clock import Clock, VirtualClock
from madrob_console.common.names import SourceKind
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.playback import PlaybackCommand, PlaybackView, PlayOrPause, SetSpeed
from madrob_console.engine.runtime.disk import DiskJobs, DiskThreads
from madrob_console.engine.runtime.replay import Replay
from madrob_console.engine.runtime.scorer import Scorer
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.engine.snapshot import Snapshot
from madrob_console.messages.codec import ROBOT_TYPES, decode_text, describe_topic, referee_topics
from madrob_console.messages.mapping import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.messages.types import MessageTypes
from madrob_console.referee.acts import (
    Act,
    ConfirmPose,
    DeclareTimeout,
    Finalise,
    SetUp,
    Start,
    TakeBack,
    ZeroHandle,
)
from madrob_console.referee.acts.correct import last_decision
from madrob_console.referee.flags import undecided
from madrob_console.referee.records import CheckName, TeamWord
from madrob_console.referee.run import Phase
from madrob_console.referee.run_setup import RunSetup
from madrob_console.testbeds.announcement import INFO_TOPIC, INFO_TYPE, SILENT, Announcement
from madrob_console.testbeds.simulated import Scenario
from madrob_console.testbeds.simulated.sensor_model import SensorSettings
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from madrob_console.testbeds.source import TopicStatus
from recorder.bag import RawMessage, Topic
from recorder.reader import Bag
from scoring.indicator_table import RulesetName
from scoring.protocol import BenchmarkType, Condition, LockDetection, Side, StartPose
from scoring.result import Result
from tests.madrob_console.engine.spoilt import (
    HANDLE,
    STRING,
    Edit,
    Fault,
    Spoil,
    edited,
    set_value,
    spoiler,
)
from tests.madrob_console.robots import Played, any_testbed
from tests.watching import until

EPOCH_NS = 1_700_000_000_000_000_000
STEP = 0.02
_SEEDS = count()
"""Of the random bytes: each engine has its own, and a process of tests always the same ones."""
_ON_DISK_NS = 100_000_000  # how old the newest message may be
PULL = Condition(BenchmarkType.NO_FORCE, Side.CCW, Side.CCW)


class Drive:
    """An engine on a simulated testbed, driven as a referee would."""

    SOURCE = SimulatedSource

    def __init__(
        self,
        results: Path,
        scenario: Played = Scenario.NOMINAL,
        seed: int = 0,
        *,
        latch: bool = False,
        disk: DiskThreads | None = None,
        scorer: Scorer | None = None,
        testbed: str = "Hall A",
        disk_needed: int = 0,
        competition: str = "",
        mappings: Sequence[TopicMapping] = DEFAULT_MAPPINGS,
        clock: Clock | None = None,
        lossless: bool = True,
        usual_setup: Callable[[RunSetup], RunSetup] = lambda setup: setup,
    ) -> None:
        self.clock = clock or VirtualClock(EPOCH_NS)
        types = MessageTypes()
        simulated = any_testbed(scenario, seed, sensors=SensorSettings(latch=latch))
        self.source = self.SOURCE(simulated, self.clock, types, mappings)
        config = EngineConfig(
            results,
            tuple(mappings),
            lossless=lossless,
            disk_needed=disk_needed,
            testbed=testbed,
            competition=competition,
            usual_setup=usual_setup,
            random=Random(next(_SEEDS)).randbytes,
        )
        # a busy machine must not use up the 2 s that an act has for the disk
        disk = disk or DiskThreads(DiskJobs(), DiskJobs(), lambda: self.clock.now_ns() / 1e9)
        self.engine = Engine(self.source, self.clock, config, types, disk=disk, scorer=scorer)
        self.engine.open()

    @property
    def folder(self) -> Path:
        """Of the run at hand."""
        assert self.engine.folder is not None
        return self.engine.folder

    def wait(self, duration: float) -> None:
        end = self.engine.now() + duration
        while self.engine.now() < end:
            self.engine.step(STEP)

    def wait_until(self, done: Callable[[], bool], patience: float = 400.0) -> None:
        end = self.engine.now() + patience
        while not done():
            assert self.engine.now() < end, "waited in vain"
            self.engine.step(STEP)

    def wait_for_disk(self) -> None:
        """Until everything so far is on the disk: the recorder writes in a thread of its own."""
        now = self.clock.now_ns()

        def newest() -> int:
            return max((m.receive_ns for m in Bag(self.folder).messages()), default=0)

        until(lambda: newest() > now - _ON_DISK_NS)

    def cut_off_copy(self, results: Path) -> Path:
        """Another results folder with the run as a kill of the engine would leave it now."""
        self.wait_for_disk()
        place = self.folder.relative_to(self.engine.config.results)
        return Path(shutil.copytree(self.folder, results / place))

    def open(self, folder: Path, *, invalid: bool = False) -> str | None:
        """Open an earlier run; why that is refused."""
        told: list[str | None] = []
        self.engine.open_run(self.engine.read_run(folder).result(), told.append, invalid=invalid)
        while not told:
            self.engine.step(STEP)
        return told[0]

    def act(self, *acts: Act) -> None:
        for act in acts:
            assert self.engine.perform(act) is None

    def prepare(self, setup: RunSetup) -> None:
        """Everything up to the start."""
        self.act(SetUp(setup))
        self.wait(1.5)
        self.act(ZeroHandle(), ConfirmPose())

    def count_down(self, setup: RunSetup) -> None:
        """Prepare, and begin the countdown."""
        self.prepare(setup)
        self.act(Start())

    def start(self, setup: RunSetup) -> None:
        """Prepare and wait until the run goes on."""
        self.count_down(setup)
        self.wait_until(lambda: self.engine.run.phase is Phase.RUNNING)

    def check(self, name: CheckName) -> str:
        """What a pre-start check says, with its state."""
        check = next(c for c in self.engine.snapshot().checks if c.name is name)
        return f"{check.state}: {check.reason}"

    def finish(self) -> None:
        self.wait_until(lambda: self.engine.scored is not None)

    @property
    def start_time(self) -> float:
        """Of the run, planned or past, s since the epoch."""
        assert self.engine.run.start is not None
        return self.engine.run.start

    def scored_result(self) -> Result:
        """The run's result, waited for."""
        self.finish()
        assert self.engine.scored is not None
        return self.engine.scored.result

    def rescored(self) -> Result:
        """Of the run, scored again."""
        return next(score(self.folder)).result

    def recorded(self, topic: str) -> list[bytes]:
        """What the bag holds of a topic."""
        return [m.data for m in Bag(self.folder).messages() if m.topic == topic]

    def take_back(self) -> None:
        """The last decision."""
        last = last_decision(self.engine.run)
        assert last is not None
        self.act(TakeBack(last.kind, last.time, "my mistake"))

    def same_everywhere(self) -> Result:
        """The result, waited for; the run scored again and replayed has the same one."""
        result = self.scored_result()
        assert self.rescored() == result
        deck = Deck(self.folder, speed=0.0)
        deck.to_the_end()
        assert (deck.at.comparison, deck.at.agrees) == (EQUAL, True)
        return result

    def scored(self) -> Scored:
        """The scored run with its data, as its report is made from it."""
        return score_opened(self.folder)

    def give_up(self) -> None:
        """The run is over as soon as it goes on."""
        self.wait_until(lambda: self.engine.run.phase is Phase.RUNNING)
        self.act(DeclareTimeout("gave up"))
        self.finish()

    def whole_run(self, setup: RunSetup) -> None:
        self.start(setup)
        self.finish()


class OfficialSource(SimulatedSource):
    """As good as a real testbed."""

    kind = SourceKind.ROS
    announcement = SILENT


class OfficialDrive(Drive):
    """Its runs count."""

    SOURCE = OfficialSource


TIMEOUT = 16.0
"""Of a run, s; the robot needs 13.85 s."""
TYPES = MessageTypes()


class FaultySource(OfficialSource):
    """A simulated testbed as good as a real one, honest until told otherwise; its robot speaks.

    Attributes:
        handed: every message handed to the engine, in order.
        published: every message that the engine published, in order.
        other_referee: who else publishes the state of the run, in words.
        announcement: what the testbed says of itself.
    """

    other_referee: str | None = None
    announcement: Announcement = SILENT

    def __init__(self, *testbed: Any, **more: Any) -> None:  # noqa: ANN401  of the simulated one
        super().__init__(*testbed, **more)
        self.handed: list[RawMessage] = []
        self.published: list[RawMessage] = []
        self._spoils: dict[str, Spoil] = {}
        self._doubled: set[str] = set()
        self._coming: list[RawMessage] = []
        self._deliver: Callable[[int], int] = lambda at: at

    def topics(self) -> tuple[Topic, ...]:
        spoken = (describe_topic(TYPES, name, kind) for name, kind in ROBOT_TYPES.items())
        info = (Topic(INFO_TOPIC, INFO_TYPE, TYPES.definition(INFO_TYPE), ""),)
        return (*super().topics(), *spoken, *info[: len(self.announcement.messages)])

    def say(self, topic: str, data: bytes, at_ns: int) -> None:
        """The robot says something at a time."""
        self._coming.append(RawMessage(topic, ROBOT_TYPES[topic], data, at_ns, at_ns))

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
        self.replace_messages(topic, spoil)

    def replace_messages(self, topic: str, spoil: Spoil) -> None:
        """From now on this comes instead, from as many publishers as before."""
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

    def publish(self, message: RawMessage) -> None:
        self.published.append(message)
        super().publish(message)


class FaultyDrive(Drive):
    """A drive on a testbed that can be spoiled; its runs count."""

    source: FaultySource

    SOURCE = FaultySource

    def touch(self, topic: str = HANDLE, value: float = 40.0) -> None:
        """Something moves for 0.3 s: the handle is pulled, if nothing else is said."""
        self.source.fake(topic, partial(set_value, value=value))
        self.wait(0.3)
        self.source.heal(topic)
        self.wait(0.3)

    def hear(self, topic: str, data: bytes, after: float) -> None:
        """The robot says this so long after the start, s."""
        self.source.say(topic, data, round((self.start_time + after) * 1e9))

    def published(self, topic: str) -> list[Any]:
        """The contents of what was published on a topic of the referee."""
        kind = next(each.type for each in referee_topics(TYPES) if each.name == topic)
        said = [m.data for m in self.source.published if m.topic == topic]
        if kind == STRING:
            return [json.loads(decode_text(TYPES, data)) for data in said]
        return [TYPES.decode(kind, data).data for data in said]

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
        self.source.spoil(topic, fault)

    def topics(self) -> list[str]:
        """The topics that a testbed must have."""
        return [view.topic for view in self.engine.snapshot().topics if not view.optional]

    def begin(self) -> None:
        """Start, and count from here what is handed to the engine: all of it is recorded."""
        self.act(Start())
        self.source.handed.clear()

    def handed(self, topic: str) -> list[bytes]:
        """What came on a topic since the recording began."""
        return [message.data for message in self.source.handed if message.topic == topic]

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


@dataclass
class RealTime:
    """Real time for a test: it passes only where somebody waits or works."""

    now: float = 50.0
    work: float = 0.0

    def monotonic(self) -> float:
        self.now += self.work
        return self.now

    def wait(self, duration: float) -> None:
        self.now += duration


class Deck:
    """A replay in time that a test lets pass."""

    def __init__(self, path: Path, speed: float = 1.0, work: float = 0.0) -> None:
        self.world = RealTime(work=work)
        config = EngineConfig(path.parent / "never made", DEFAULT_MAPPINGS, disk_needed=0)
        types = MessageTypes()
        replay = Replay(path, types, speed, self.world.monotonic, self.world.wait)
        self.engine = Engine.of_recording(replay, config, types)
        self.engine.open()

    def step(self, count: int = 1) -> None:
        for _ in range(count):
            self.engine.step(0.02)

    def let_pass(self, duration: float) -> None:
        end = self.world.now + duration
        while self.world.now < end - 1e-6:
            self.engine.step(0.02)

    def do(self, *commands: PlaybackCommand) -> None:
        for command in commands:
            assert self.engine.control(command) is None
            while self.at.jumping_to is not None:
                self.engine.step(0.02)

    def to_the_end(self) -> Snapshot:
        self.engine.control(SetSpeed(0))
        if self.at.paused:
            self.engine.control(PlayOrPause())
        while not self.at.ended:
            self.engine.step(0.02)
        return self.shown

    @property
    def shown(self) -> Snapshot:
        return self.engine.snapshot()

    @property
    def at(self) -> PlaybackView:
        playback = self.shown.playback
        assert playback is not None
        return playback


def make_setup(
    condition: Condition = PULL,
    *,
    run_number: int = 1,
    timeout: float = 60.0,
    countdown: float = 2.0,
    ruleset: RulesetName = RulesetName.PROTOCOL,
    lock_detection: LockDetection = LockDetection.AUTO,
) -> RunSetup:
    return RunSetup(
        subject=3,
        team="Delft",
        run_number=run_number,
        condition=condition,
        start_pose=StartPose(1.5 * condition.starting_side.sign, 0.0, 0.0),
        referee="R. Eferee",
        timeout=timeout,
        countdown=countdown,
        ruleset=ruleset,
        lock_detection=lock_detection,
    )


def document(folder: Path) -> dict[str, Any]:
    """The result of a run, as it is on disk."""
    content: dict[str, Any] = json.loads((folder / "result.json").read_text())
    return content


def signed(snapshot: Snapshot, word: TeamWord = TeamWord.ACKNOWLEDGED, note: str = "") -> Finalise:
    """With what is undecided named: a robot at random or a busy machine brings doubts."""
    left = tuple(flag.words for flag in undecided(snapshot.flags))
    return Finalise(word, "R. Eferee", note, left)
