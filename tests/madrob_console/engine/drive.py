"""Whole runs on the simulated testbed in virtual time, with real files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path
from random import Random

from madrob_console.archive.scored import Scored, score_opened
from madrob_console.common.clock import Clock, VirtualClock
from madrob_console.common.names import SourceKind
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.runtime.disk import DiskThreads
from madrob_console.engine.runtime.scorer import Scorer
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.engine.snapshot import Snapshot
from madrob_console.messages.codec import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.messages.message_types import MessageTypes
from madrob_console.referee.acts import (
    Act,
    ConfirmPose,
    DeclareTimeout,
    Finalise,
    SetUp,
    Start,
    ZeroHandle,
)
from madrob_console.referee.flags import undecided
from madrob_console.referee.records import CheckName, RunSetup, TeamWord
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from madrob_console.testbeds.simulated.sensor_model import SensorSettings
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from madrob_console.testbeds.source import INFO_TOPIC, INFO_TYPE, SILENT, Announcement
from recorder.bag import Topic
from recorder.reader import Bag
from scoring.protocol import BenchmarkType, Condition, LockDetection, Side, StartPose
from scoring.rulesets import RulesetName
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
        folder, now = self.engine.folder, self.clock.now_ns()
        assert folder is not None

        def newest() -> int:
            return max((m.receive_ns for m in Bag(folder).messages()), default=0)

        until(lambda: newest() > now - _ON_DISK_NS)

    def open(self, folder: Path, *, invalid: bool = False) -> str | None:
        """Open an earlier run; why that is refused."""
        told: list[str | None] = []
        self.engine.open_run(self.engine.read_run(folder).result(), told.append, invalid=invalid)
        while not told:
            self.engine.step(STEP)
        (refused,) = told
        return refused

    def act(self, *acts: Act) -> None:
        for act in acts:
            assert self.engine.perform(act) is None

    def prepare(self, setup: RunSetup) -> None:
        """Everything up to the start."""
        self.act(SetUp(setup))
        self.wait(1.5)
        self.act(ZeroHandle(), ConfirmPose())

    def start(self, setup: RunSetup) -> None:
        """Prepare and wait until the run goes on."""
        self.prepare(setup)
        self.act(Start())
        self.wait_until(lambda: self.engine.run.phase is Phase.RUNNING)

    def check(self, name: CheckName) -> str:
        """What a pre-start check says, with its state."""
        check = next(c for c in self.engine.snapshot().checks if c.name is name)
        return f"{check.state}: {check.reason}"

    def finish(self) -> None:
        self.wait_until(lambda: self.engine.scored is not None)

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


class AnnouncedSource(SimulatedSource):
    """A testbed over ROS that says of itself what a test lets it say."""

    kind = SourceKind.ROS
    told: Announcement = SILENT

    @property
    def announcement(self) -> Announcement:
        return self.told

    def topics(self) -> tuple[Topic, ...]:
        said = (Topic(INFO_TOPIC, INFO_TYPE, MessageTypes().definition(INFO_TYPE), ""),)
        return (*super().topics(), *(said if self.told.messages else ()))


class Rehearsal(Drive):
    """A referee at such a testbed."""

    source: AnnouncedSource

    SOURCE = AnnouncedSource


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


def signed(snapshot: Snapshot, word: TeamWord = TeamWord.ACKNOWLEDGED, note: str = "") -> Finalise:
    """With what is undecided named: a robot at random or a busy machine brings doubts."""
    left = tuple(flag.words for flag in undecided(snapshot.flags))
    return Finalise(word, "R. Eferee", note, left)
