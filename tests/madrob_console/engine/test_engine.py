"""What a referee can rely on, with real files in virtual time: what is kept of a run."""

from __future__ import annotations

import json
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from io import BytesIO, StringIO
from pathlib import Path
from traceback import format_stack
from types import FrameType

import pytest

from madrob_console.archive import score
from madrob_console.engine.requests import NextRunNumber, OpenRun
from madrob_console.engine.runtime.engine_thread import LocalEngine
from madrob_console.engine.runtime.scoring_process import ScoringProcess
from madrob_console.messages.codec import (
    REFEREE_EVENT_TOPIC,
    REFEREE_STATE_TOPIC,
    decode_text,
)
from madrob_console.messages.message_types import MessageTypes
from madrob_console.referee.acts import (
    Abort,
    Act,
    AddNote,
    ConfirmPose,
    Correct,
    DeclareTimeout,
    Finalise,
    MarkIncident,
    Reissue,
    RestartCountdown,
    Rule,
    SetUp,
    Start,
    TakeBack,
    Void,
    ZeroHandle,
)
from madrob_console.referee.checks import CheckState
from madrob_console.referee.journal import HOLD_FILE, read_journal
from madrob_console.referee.records import CheckName, DecisionKind, IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from madrob_console.testbeds.simulated import Scenario
from recorder.reader import Bag
from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition, LockDetection, Outcome, Step
from scoring.rulesets import RulesetName
from tests.madrob_console.engine.drive import Deck, Drive, document, make_setup
from tests.madrob_console.engine.reporting import no_reporting
from tests.madrob_console.engine.served import act, kept_running, simulated, start
from tests.madrob_console.robots import Played, Robot
from tests.slowly import slow_but_for
from tests.watching import until

TYPES = MessageTypes()


def value(path: Path, name: IndicatorName) -> float:
    found: float = document(path)["indicators"][name]["value"]
    return found


def test_a_nominal_run_is_completed_recorded_scored_and_told(drive: Drive) -> None:
    drive.start(make_setup())
    result = drive.result()
    assert (result.outcome, result.quality.remarks) == (Outcome.COMPLETED, ())
    assert all(i.value is not None for i in result.indicators.values())
    assert value(drive.folder, IndicatorName.TIME_TO_HANDLE) > 1.0  # by the handle's zero
    names = {path.name for path in drive.folder.iterdir()}
    prefix = "subject_003_cond_001_run_001"
    assert drive.folder.name.startswith(prefix)
    assert names == {
        f"{drive.folder.name}_0.mcap", "metadata.yaml", f"run_info_{prefix}.yaml",
        "condition_1.yaml", f"{prefix}_event.csv", f"{prefix}_jointState.csv",
        f"{prefix}_wrench.csv", "journal.jsonl", "result.json", HOLD_FILE,
        *(f"{name}.yaml" for name in IndicatorName),
    }  # fmt: skip
    said = [line.text for line in drive.engine.log.lines if line.origin == "sensor"]
    assert set(said) == {
        "handle touched",
        "door opens",
        "robot approaches on the CCW side",
        "robot leaves the doorway on the CW side",
        "door closes",
    }
    assert not any("_" in line.text for line in drive.engine.log.lines)


def test_abort_wins_at_once_keeps_the_run_and_opens_a_clean_next_one(drive: Drive) -> None:
    drive.start(make_setup())
    drive.wait(3.0)
    drive.act(Abort("robot on fire"))
    assert drive.engine.run.phase is Phase.STOPPED
    assert drive.engine.snapshot().elapsed == pytest.approx(3.0, abs=0.05)
    drive.finish()
    stored = document(drive.folder)
    assert (stored["outcome"], stored["outcome_reason"]) == ("aborted", "robot on fire")
    assert {i["reason"] for i in stored["indicators"].values()} == {"run aborted: invalid"}
    assert not list(drive.folder.glob("execution_time.yaml"))
    assert drive.engine.next_run_number(3, 1, practice=True).result() == 2
    drive.act(SetUp(make_setup(run_number=2)))
    clean = drive.engine.snapshot()
    assert (clean.result, clean.folder, clean.elapsed, clean.provisional) == (None, None, None, {})
    assert not clean.run.pose_confirmed


def test_a_declared_timeout_counts_from_its_instant(tmp_path: Path) -> None:
    drive = Drive(tmp_path, Scenario.TOUCH_ONLY)
    drive.start(make_setup())
    drive.wait(5.0)
    declared = drive.engine.now()
    drive.act(DeclareTimeout("gave up"))
    drive.wait_until(lambda: drive.engine.run.phase is Phase.STOPPED)
    drive.act(Void("it fell on somebody"))  # before it is scored
    drive.finish()
    assert (drive.engine.run.outcome, drive.engine.run.stop) == (Outcome.TIMEOUT, declared)
    assert document(drive.folder)["voided"]["reason"] == "it fell on somebody"
    assert document(drive.folder)["issue"] == 1
    assert value(drive.folder, IndicatorName.EXECUTION_TIME) == pytest.approx(5.0, abs=0.05)


def test_the_referee_can_stop_a_run_that_only_he_can_judge(drive: Drive) -> None:
    drive.start(make_setup(lock_detection=LockDetection.REFEREE))
    drive.wait_until(lambda: drive.engine.snapshot().ask_referee is not None)
    drive.wait(2.0)
    judged = drive.engine.now()
    drive.act(Rule(Step.LOCK, confirmed=True, reason="heard the click"))
    drive.finish()
    assert (drive.engine.run.outcome, drive.engine.run.stop) == (Outcome.COMPLETED, judged)


def test_a_ruling_after_the_stop_changes_the_result_on_disk_and_keeps_what_was_found(
    drive: Drive,
) -> None:
    drive.whole_run(make_setup())
    drive.act(Rule(Step.CROSS, confirmed=False, reason="arm only"))
    step = document(drive.folder)["steps"][3]
    assert value(drive.folder, IndicatorName.CAPABILITY_LEVEL) == 3
    assert step["sensors"] is not None
    assert (step["referee"]["reason"], step["final"]) == ("arm only", None)
    assert drive.rescored() == drive.result()


def test_without_a_testbed_nothing_starts_and_nothing_is_shown_as_good(drive: Drive) -> None:
    drive.source.close()
    drive.act(SetUp(make_setup()))
    drive.wait(1.0)
    shown = drive.engine.snapshot()
    assert {c.state for c in shown.checks} >= {CheckState.NO_DATA, CheckState.FAILED}
    assert not any(c.state is CheckState.OK for c in shown.checks if c.name in {
        CheckName.TOPICS, CheckName.DOOR, CheckName.HANDLE, CheckName.DOORWAY, CheckName.CLOCK
    })  # fmt: skip
    assert shown.door.angle is None
    assert {s.occupied for s in shown.passage} == {None}
    assert drive.engine.perform(Start()) is not None


@pytest.mark.parametrize("ruleset", list(RulesetName))
@pytest.mark.parametrize(
    "scenario",
    slow_but_for([Scenario.NOMINAL, Robot.BOUNCES, Robot.OPEN_ONLY], Robot.BOUNCES),
)
def test_bag_replay_and_live_run_give_the_same_digits(
    scenario: Played, ruleset: RulesetName, tmp_path: Path
) -> None:
    drive = Drive(tmp_path / "live", scenario, seed=5)
    drive.start(make_setup(ruleset=ruleset, timeout=30.0))
    live, folder = drive.same_everywhere(), drive.folder
    drive.engine.close()
    bag_alone = tmp_path / "elsewhere"
    bag_alone.mkdir()
    for name in (f"{folder.name}_0.mcap", "metadata.yaml"):
        shutil.copy(folder / name, bag_alone)
    assert next(score(bag_alone)).result == Deck(bag_alone).to_the_end().result == live


def test_every_act_and_change_is_in_journal_and_bag_with_a_second_around_the_run(
    drive: Drive,
) -> None:
    drive.whole_run(make_setup(timeout=1.0))
    again = SetUp(make_setup(run_number=2, countdown=0.0))
    drive.act(again)
    assert drive.engine.log.lines[0].relative is None  # not a time of the run before
    drive.act(again)
    drive.wait(1.5)
    drive.act(ZeroHandle(), ConfirmPose(), Start())
    drive.wait(0.3)
    drive.act(RestartCountdown(), MarkIncident(IncidentKind.COLLISION, "door frame"))
    drive.finish()
    entries, remarks = read_journal(drive.folder / "journal.jsonl")
    assert remarks == ()
    what = [entry.what for entry in entries if entry.what != "event"]
    assert what == [
        *("set up", "zero the handle", "confirm the start pose", "start", "countdown begins"),
        *("restart the countdown", "countdown begins", "mark an incident", "run starts"),
        *("run stops", "result written"),
    ]
    assert {e.referee for e in entries if e.origin == "referee"} == {"R. Eferee"}
    messages = list(Bag(drive.folder).messages())
    said = [m.topic for m in messages if m.topic.startswith("/madrob/referee/")]
    assert [topic.rpartition("/")[2] for topic in said[:3]] == ["event", "start_pose", "state"]
    # the result is written after the bag is closed
    assert said.count(REFEREE_EVENT_TOPIC) == len(entries) - 1
    states = [json.loads(decode_text(TYPES, one)) for one in drive.recorded(REFEREE_STATE_TOPIC)]
    phases, starts = zip(*((state["phase"], state["start_time"]) for state in states), strict=True)
    assert phases == ("ready", "countdown", "countdown", "running", "stopped")
    assert starts[2] == pytest.approx(starts[1] + 0.3, abs=0.05)
    times, stop = [m.receive_ns / 1e9 for m in messages], drive.result().stop
    assert min(times) <= drive.start_time - 0.99
    assert max(times) >= (stop or 0.0) + 1.0 + 0.99  # the settle time, then the post-roll


SIGNED = Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee")
_CORE, _KEEPERS = "engine", ("disk", "reading")
_FRAMES = 6
SPEED, PATIENCE = 1.0, 120.0  # a core that is watched is slow, and the machine may be busy
_FILES = ("posix", "fcntl", "_io")
_NO_FILE = {"fspath", "eventfd_write"}  # the latter: the bell of the workers' thread
_EVENTS = ("open", "os.", "fcntl.", "shutil.", "glob.", "pathlib.", "tempfile.")


class Watch:
    """What threads of an engine do.

    Attributes:
        calls: of built-in functions by the core.
        found: what it did that it should not, and the keepers, too.
    """

    def __init__(self) -> None:
        self.calls = 0
        self.found: set[str] = set()

    def audited(self, event: str, arguments: tuple[object, ...]) -> None:
        """Python reports something."""
        thread = threading.current_thread().name
        imports = event == "import" and thread in (_CORE, *_KEEPERS)
        if imports or (thread == _CORE and event.startswith(_EVENTS)):
            self._tell(f"{thread}: {event} {arguments[:1]}", sys._getframe(2))

    def profiled(self, frame: FrameType, event: str, function: object) -> None:
        """Something is called."""
        if event != "c_call" or threading.current_thread().name != _CORE:
            return
        self.calls += 1
        owner = getattr(function, "__self__", None)
        if isinstance(owner, BytesIO | StringIO):
            return
        module = getattr(function, "__module__", None) or type(owner).__module__
        name = getattr(function, "__name__", "")
        if module in _FILES and name not in _NO_FILE:
            self._tell(f"{module}.{name}", frame)

    def _tell(self, what: str, frame: FrameType | None) -> None:
        self.found.add(f"{what}: {''.join(format_stack(frame, _FRAMES))}")


_watches: list[Watch] = []


def _audited(event: str, arguments: tuple[object, ...]) -> None:
    for watch in _watches:
        watch.audited(event, arguments)


sys.addaudithook(_audited)  # for good: it cannot be taken away again


@contextmanager
def watched() -> Iterator[Watch]:
    """Watch each engine that is made inside."""
    watch = Watch()
    _watches.append(watch)
    threading.setprofile(watch.profiled)
    try:
        yield watch
    finally:
        threading.setprofile(None)
        _watches.clear()


@pytest.mark.machine
@pytest.mark.timeout(240)
def test_the_core_touches_no_file_and_imports_nothing(tmp_path: Path) -> None:
    scorer = ScoringProcess()
    engine = simulated(tmp_path / "runs", SPEED, scorer=scorer)
    reporting = no_reporting(engine.config.results)
    with (
        kept_running(scorer),
        watched() as watch,
        closing(LocalEngine(engine, reporting)) as local,
    ):

        def done(*acts: Act) -> None:
            for one in acts:
                until(lambda one=one: act(local, one) is None)  # type: ignore[misc]

        start(local)
        done(AddNote("all is well"), MarkIncident(IncidentKind.COLLISION, "door frame"))
        until(lambda: local.snapshot().result is not None, PATIENCE)
        assert local.snapshot().run.outcome is Outcome.COMPLETED
        first = f"practice/{Path(local.snapshot().folder or '').name}"
        done(Rule(Step.TOUCH, confirmed=False, reason="video"), SIGNED, Reissue("appeal"), SIGNED)
        done(Void("unsafe"), Correct(3, Condition.from_number(11), "typed wrongly"))
        last = local.snapshot().run.corrections[-1].time
        done(TakeBack(DecisionKind.CORRECTION, last, "my mistake"), SIGNED)
        number = local.send_request(NextRunNumber(3, 1, practice=True))
        done(SetUp(make_setup(run_number=number, countdown=5.0)))
        until(lambda: local.snapshot().run.phase is Phase.READY)
        done(ZeroHandle(), ConfirmPose(), Start(), RestartCountdown("robot not ready"))
        until(lambda: local.snapshot().run.phase is Phase.RUNNING)
        done(Abort("enough"))
        until(lambda: local.snapshot().result is not None)
        assert local.send_request(OpenRun(first)) is None
        until(lambda: local.snapshot().opened)
        done(Reissue("once more"), AddNote("afterwards"), SIGNED)
        until(lambda: local.snapshot().run.issue == 4 and local.snapshot().result is not None)
        assert local.snapshot().run.phase is Phase.FINAL
        assert watch.calls > 10_000
        assert not watch.found, "\n".join(sorted(watch.found))
