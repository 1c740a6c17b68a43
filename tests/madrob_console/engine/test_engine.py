"""What a referee can rely on, with real files in virtual time: what is kept of a run."""

from __future__ import annotations

import gc
import json
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from io import BytesIO, StringIO
from pathlib import Path
from types import FrameType

import jsonschema
import pytest

from madrob_console.archive import score
from madrob_console.archive.collection import matches
from madrob_console.archive.history import History
from madrob_console.archive.result_document import result_schema
from madrob_console.cli.unattended_run import UnattendedRun
from madrob_console.common.errors import MadrobError
from madrob_console.engine.playback import JumpTo
from madrob_console.engine.requests import NextRunNumber, OpenRun
from madrob_console.engine.runtime.engine_thread import LocalEngine
from madrob_console.engine.runtime.scoring_process import ScoringProcess
from madrob_console.messages.codec import REFEREE_EVENT_TOPIC, REFEREE_STATE_TOPIC, decode_text
from madrob_console.messages.types import Message, MessageTypes
from madrob_console.referee.acts import (
    Abort,
    AcceptDoubts,
    AcceptFalseStart,
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
from madrob_console.referee.flags import undecided, waiting_doubts
from madrob_console.referee.journal import HOLD_FILE, read_journal
from madrob_console.referee.rebuild import Change, rebuild
from madrob_console.referee.records import CheckName, DecisionKind, IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from madrob_console.referee.team_list import TeamList
from madrob_console.testbeds.simulated import Scenario
from recorder.reader import Bag
from scoring.indicator_table import IndicatorName, RulesetName
from scoring.protocol import Condition, EventName, LockDetection, Outcome, Step
from tests.madrob_console.engine.drive import Deck, Drive, FaultyDrive, document, make_setup
from tests.madrob_console.engine.reporting import no_reporting
from tests.madrob_console.engine.served import act, kept_running, simulated, start
from tests.madrob_console.engine.spoilt import DOOR, HANDLE, set_value
from tests.madrob_console.robots import Played, Robot
from tests.slowly import slow_but_for
from tests.watching import until

TYPES = MessageTypes()


def value(path: Path, name: IndicatorName) -> float:
    found: float = document(path)["indicators"][name]["value"]
    return found


def test_a_nominal_run_is_completed_recorded_scored_and_told(drive: Drive) -> None:
    drive.start(make_setup())
    result = drive.scored_result()
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
    assert drive.rescored() == drive.scored_result()


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
    states = [json.loads(decode_text(TYPES, data)) for data in drive.recorded(REFEREE_STATE_TOPIC)]
    phases, starts = zip(*((state["phase"], state["start_time"]) for state in states), strict=True)
    assert phases == ("ready", "countdown", "countdown", "running", "stopped")
    assert starts[2] == pytest.approx(starts[1] + 0.3, abs=0.05)
    times, stop = [m.receive_ns / 1e9 for m in messages], drive.scored_result().stop
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
        """Note it and where it is; to read the source for that would be one more file."""
        places: list[str] = []
        while frame is not None and len(places) < _FRAMES:
            places.append(f"{frame.f_code.co_filename}:{frame.f_lineno}")
            frame = frame.f_back
        self.found.add(f"{what}: {', '.join(places)}")


_watches: list[Watch] = []


def _audited(event: str, arguments: tuple[object, ...]) -> None:
    for watch in _watches:
        watch.audited(event, arguments)


sys.addaudithook(_audited)  # for good: it cannot be taken away again


@contextmanager
def watched() -> Iterator[Watch]:
    """Watch each engine that is made inside.

    What tests before have left for the garbage collector is not for the core to end.
    """
    watch = Watch()
    gc.collect()
    gc.disable()
    _watches.append(watch)
    threading.setprofile(watch.profiled)
    try:
        yield watch
    finally:
        threading.setprofile(None)
        _watches.clear()
        gc.enable()


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


LONG = 3.0
"""s that a countdown is held, longer than it takes."""


def hold(hall: FaultyDrive) -> float:
    """A run whose countdown of 2 s is held after half a second; returns what is left of it, s."""
    hall.count_down(make_setup())
    hall.wait(0.5)
    hall.touch()
    left = hall.engine.snapshot().remaining
    assert left is not None
    assert 0.5 < left < 1.5
    return left


def test_a_held_countdown_goes_on_where_it_was_once_all_is_accepted_or_begins_anew(
    hall: FaultyDrive,
) -> None:
    left = hold(hall)
    hall.touch(DOOR, 0.4)  # all while it is held is one question
    hall.wait(LONG)
    shown, states = hall.engine.snapshot(), hall.published(REFEREE_STATE_TOPIC)
    assert (shown.run.phase, shown.remaining) == (Phase.COUNTDOWN, left)
    assert shown.elapsed == pytest.approx(-left)
    assert [mark.event for mark in shown.run.false_starts] == [
        EventName.HANDLE_IS_TOUCHED,
        EventName.DOOR_OPENS,
    ]
    assert [state["start_time"] is None for state in states[-2:]] == [False, True]
    assert [line.relative for line in hall.engine.log.lines][-1] is None
    hall.act(AcceptFalseStart("nothing gained"))
    again = hall.engine.snapshot()
    assert again.run.held is None
    assert again.remaining == pytest.approx(left)
    assert {mark.accepted for mark in again.run.false_starts} == {"nothing gained"}
    assert hall.start_time == pytest.approx(again.time + left, abs=1e-6)
    assert hall.published(REFEREE_STATE_TOPIC)[-1]["start_time"] == hall.start_time
    hall.wait(0.1)
    hall.touch()  # a later touch is another one
    marks = hall.engine.run.false_starts
    assert [mark.accepted is None for mark in marks] == [False, False, True]
    hall.wait(LONG)
    hall.act(RestartCountdown())
    assert hall.engine.snapshot().remaining == pytest.approx(2.0, abs=0.1)
    assert hall.same_everywhere().outcome is Outcome.COMPLETED
    assert hall.engine.run.undecided_false_start is None
    deck = Deck(hall.folder)
    deck.do(JumpTo(-2.5))
    assert (deck.shown.run.phase, deck.shown.run.held is None) == (Phase.COUNTDOWN, False)


def test_an_undecided_false_start_is_signed_only_by_who_knows_of_it(
    hall: FaultyDrive, tmp_path: Path
) -> None:
    hall.count_down(make_setup())
    hall.wait(1.95)
    hall.source.deliver(lambda at_ns: at_ns + 60_000_000)  # it is heard of after the start
    hall.touch()
    run = hall.engine.run
    assert (run.phase, run.held) == (Phase.RUNNING, None)
    assert run.undecided_false_start is not None
    assert run.undecided_false_start.time < hall.start_time
    assert hall.same_everywhere().outcome is Outcome.COMPLETED
    words = "1 false start UNDECIDED (handle touched)"

    def flagged() -> str:
        """In the words of result, list and screen, which are the same."""
        stored = document(hall.folder)["flags"][0]["words"]
        (listed,) = History(tmp_path).refresh()
        assert stored == listed.flags[0].words == hall.engine.snapshot().flags[0].words
        assert matches(listed, "undecided") is (stored == words)
        return str(stored)

    doubts = waiting_doubts(hall.engine.situation().indicators, ())
    hall.act(AcceptDoubts(doubts, "late messages"))
    stored = document(hall.folder)
    jsonschema.validate(stored, result_schema())
    (accepted,) = stored["accepted_doubts"]
    assert accepted["reason"] == "late messages"
    assert accepted["doubts"] == {str(name): [*each] for name, each in doubts.items()}
    assert doubts == {
        name: tuple(indicator["doubts"])
        for name, indicator in stored["indicators"].items()
        if indicator["doubts"]
    }
    (listed,) = History(tmp_path).refresh()
    assert [flag.words for flag in undecided(listed.flags)] == [words]
    assert listed.doubts == {name: len(each) for name, each in doubts.items()}
    assert {name: each.u for name, each in listed.uncertainties.items()} == {
        name: indicator["uncertainty"]["u"]
        for name, indicator in stored["indicators"].items()
        if indicator["uncertainty"]
    }
    refused = hall.engine.perform(SIGNED)
    assert refused == f"decide it first, or sign it knowing so: {words}"
    hall.act(replace(SIGNED, undecided=(words,)))
    assert flagged() == words
    hall.act(Reissue("it was seen"), AcceptFalseStart("a draught"), SIGNED)
    assert flagged() == "1 false start accepted"
    assert document(hall.folder)["false_starts"][0]["accepted"] == "a draught"


def test_a_run_that_is_aborted_or_cut_off_while_it_is_held_never_began(
    hall: FaultyDrive, tmp_path: Path
) -> None:
    left = hold(hall)
    hall.wait(LONG)
    killed = hall.cut_off_copy(tmp_path / "killed")
    entries, _ = read_journal(killed / "journal.jsonl")
    assert [entry.what for entry in entries][-2:] == [Change.FALSE_START, Change.COUNTDOWN_HELD]
    assert rebuild(entries).held == hall.engine.run.held
    hall.act(Abort("robot unsafe"))
    other = Drive(tmp_path / "killed")
    assert other.open(killed) is None
    for drive, outcome in ((hall, Outcome.ABORTED), (other, Outcome.INTERRUPTED)):
        drive.finish()
        shown = drive.engine.snapshot()
        assert (shown.run.outcome, shown.run.held) == (outcome, None)
        assert shown.elapsed == pytest.approx(-left, abs=0.1)
        assert drive.rescored() == shown.result
        assert not any(step.done for step in shown.steps)
        drive.engine.close()


@pytest.mark.parametrize(
    ("waive", "accept", "outcome"),
    [
        (None, None, None),
        ("a guest", None, Outcome.ABORTED),
        ("a guest", "a sensor test", Outcome.COMPLETED),
    ],
)
def test_a_run_without_screens_goes_on_without_a_referee_only_as_it_was_told(
    hall: FaultyDrive,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    waive: str | None,
    accept: str | None,
    outcome: Outcome | None,
) -> None:
    monkeypatch.setattr(hall.engine, "open", lambda: None)  # it is open
    hall.engine.set_teams(TeamList({3: "Delft"}))
    began = hall.engine.now()

    def pulled(message: Message) -> None:
        if began + 2.0 < hall.engine.now() < began + 2.6:
            set_value(message, 40.0)

    hall.source.fake(HANDLE, pulled)
    run, guest = UnattendedRun(hall.engine, None), replace(make_setup(), subject=9, team="")
    if outcome is None:
        with pytest.raises(MadrobError, match="9 is not in the list"):
            run.go(lambda simulated: guest, 20.0, waive, accept)
        assert hall.engine.now() < began + 10.0
        return
    assert run.go(lambda simulated: guest, 20.0, waive, accept) is outcome
    (mark,) = hall.engine.run.false_starts
    assert mark.accepted == accept
    told = "--accept-false-start WHY lets a false start pass" in capsys.readouterr().out
    assert told is (accept is None)
