"""The core on values: a run from its stop to its result, what is shown, asked and published."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeGuard

import pytest

from madrob_console.archive.unfinished_runs import Unfinished
from madrob_console.common.names import SourceKind
from madrob_console.engine.core import state_view
from madrob_console.engine.core.acting import DURABLE_WITHIN
from madrob_console.engine.core.effects import (
    Answer,
    CloseJournal,
    CloseRecording,
    ConfigureTestbed,
    Effect,
    GiveUpRecording,
    KeepJournal,
    LeaveRun,
    ListCutOffRuns,
    MakeReports,
    OpenRecording,
    PlainValue,
    Publish,
    ReopenJournal,
    RetryWriting,
    Score,
    WithdrawLine,
    WriteLine,
    WriteResult,
)
from madrob_console.engine.core.engine_config import EngineConfig
from madrob_console.engine.core.engine_core import Core
from madrob_console.engine.core.inputs import (
    CutOff,
    CutOffRunsListed,
    DoAct,
    Input,
    JournalReopened,
    LineWithdrawn,
    LineWritten,
    OpenEarlierRun,
    RecordingClosed,
    RecordingOpened,
    ResultWritten,
    RunScored,
    Tick,
)
from madrob_console.engine.core.now import DiskState, Now, TestbedState, WorkerState
from madrob_console.engine.core.run_tracker import IN_FLIGHT
from madrob_console.engine.core.scored_run import (
    EarlierRun,
    PastRun,
    RenderedResult,
    ScoringRequest,
)
from madrob_console.engine.core.state_view import elapsed, panel_fault, question, remaining
from madrob_console.engine.snapshot import DoorView, LatchView
from madrob_console.messages.codec import (
    REFEREE_ELAPSED_TOPIC,
    REFEREE_LEVEL_TOPIC,
    REFEREE_RUNNING_TOPIC,
)
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.messages.types import MessageTypes
from madrob_console.referee.acts import (
    Abort,
    Act,
    AddNote,
    ConfirmPose,
    DeclareTimeout,
    RestartCountdown,
    SetUp,
    Start,
    Waive,
)
from madrob_console.referee.checks import CheckState, blocking
from madrob_console.referee.evidence import Evidence
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change
from madrob_console.referee.records import CheckName
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.team_list import TeamList
from madrob_console.referee.topic_health import Freshness
from madrob_console.testbeds.announcement import Announcement
from madrob_console.ui.panes.result_pane import ResultHead
from recorder.bag import RawMessage
from scoring.procedure import Procedure, StepRecord
from scoring.protocol import (
    LockDetection,
    Outcome,
    Side,
    Step,
)
from scoring.result import Ending
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.test_run_values import (
    DOOR,
    NOW,
    NUMBERS,
    RECORD,
    RUN,
    START,
    TOPICS,
    handle,
    skewed,
    status,
    steady,
)
from tests.madrob_console.referee.test_acts import SETUP

FOLDER = Path("results/practice/subject_003_cond_001_run_001_20260101_100000")
TESTBED = TestbedState(SourceKind.SIMULATED, "SIMULATED nominal")
NOON = Now(1e9, 50.0, 1e9, 1e9, TESTBED, DiskState(free=10**12, problem=""))


class Values:
    """A core whose inputs a test makes; `number` is that of the last act."""

    def __init__(self) -> None:
        config = EngineConfig(Path("results"), DEFAULT_MAPPINGS, disk_needed=0)
        self.core = Core(config, MessageTypes())
        self.now = NOON
        self.number = 0

    def take(self, happened: Input, after: float = 0.0) -> list[Effect]:
        now = self.now
        self.now = replace(
            now,
            time=now.time + after,
            monotonic=now.monotonic + after,
            taken=now.taken + after,
            judged=now.judged + after,
        )
        effects = self.core.step(happened, self.now)
        return [one for one in effects if not isinstance(one, RetryWriting)]  # comes by the clock

    def do(self, act: Act) -> list[Effect]:
        self.number += 1
        return self.take(DoAct(self.number, act, ""))

    def ready(self) -> None:
        self.do(SetUp(make_setup()))
        self.do(ConfirmPose())
        for check in blocking(self.core.situation(self.now).checks):
            self.do(Waive(check.name, "nobody is here"))
        assert not blocking(self.core.situation(self.now).checks)

    def asked_to_start(self) -> OpenRecording:
        self.ready()
        (opening,) = self.do(Start())
        assert isinstance(opening, OpenRecording)
        return opening


@pytest.fixture
def values() -> Values:
    return Values()


def kinds(effects: list[Effect]) -> list[str]:
    return [
        type(one.what).__name__ if isinstance(one, Publish) else type(one).__name__
        for one in effects
    ]


def test_a_set_up_is_done_at_once_and_told_to_testbed_and_robot(values: Values) -> None:
    effects = values.do(SetUp(make_setup()))
    assert ConfigureTestbed(make_setup().condition) in effects
    assert Publish(make_setup().start_pose) in effects
    assert Answer(1, None) in effects
    assert values.core.current_run.run.phase is Phase.READY


def test_a_start_that_is_withdrawn_never_takes_effect(values: Values) -> None:
    opening = values.asked_to_start()
    (withdraw,) = values.take(Tick(), DURABLE_WITHIN)
    assert isinstance(withdraw, WithdrawLine)
    why = "the disk did not take it within 2 s: it is withdrawn"
    assert values.take(LineWithdrawn(withdraw.withdrawal)) == [Answer(values.number, why)]
    assert values.take(RecordingOpened(opening.entries[-1].id, FOLDER, None)) == []
    assert values.core.current_run.run.phase is Phase.READY


def test_an_abort_withdraws_a_start_that_waits(values: Values) -> None:
    values.asked_to_start()
    (withdraw,) = (effect for effect in values.do(Abort("?")) if isinstance(effect, WithdrawLine))
    assert withdraw.withdrawal.reason == "aborted before the countdown began: ?"


def test_a_note_that_overtakes_an_act_stands_behind_it_as_on_disk(values: Values) -> None:
    opening = values.asked_to_start()
    values.take(RecordingOpened(opening.entries[-1].id, FOLDER, None))
    handed = [one.entry for one in values.do(RestartCountdown("not ready")) if is_line(one)]
    handed += [one.entry for one in values.do(AddNote("meanwhile")) if is_line(one)]
    values.take(LineWritten(handed[0].id, None))
    stand = values.core.current_run.state.lines.entries
    assert [one.what for one in handed] == [RestartCountdown.name, AddNote.name]
    assert [one for one in stand if one in handed] == handed


def test_an_abort_wins_over_a_restart_that_is_being_written(values: Values) -> None:
    opening = values.asked_to_start()
    values.take(RecordingOpened(opening.entries[-1].id, FOLDER, None))
    values.do(RestartCountdown("robot not ready"))
    effects = values.do(Abort("enough"))
    assert Answer(values.number, None) in effects
    (withdraw,) = (effect for effect in effects if isinstance(effect, WithdrawLine))
    why = "the run has stopped: it is withdrawn"
    withdrawn = values.take(LineWithdrawn(withdraw.withdrawal))
    assert Answer(values.number - 1, why) in withdrawn
    assert values.core.current_run.run.outcome is Outcome.ABORTED


def is_line(effect: Effect) -> TypeGuard[WriteLine]:
    return isinstance(effect, WriteLine)


COUNTING, RUNNING = RUN, replace(RUN, phase=Phase.RUNNING)

HELD = replace(RUN, held=NOW + 2.0)

DONE = replace(RUN, phase=Phase.STOPPED, stop=START + 20.0)


@pytest.mark.parametrize(
    ("run", "at", "since", "left"),
    [
        (Run(), 3.0, None, None),
        (COUNTING, 3.0, -2.0, 2.0),
        (COUNTING, 6.0, 1.0, 0.0),
        (HELD, 4.0, -3.0, 3.0),
        (RUNNING, 15.0, 10.0, 290.0),
        (RUNNING, 400.0, 395.0, 0.0),
        (DONE, 400.0, 20.0, None),
    ],
)
def test_the_clock_of_a_run_goes_stands_and_stops_with_it(
    run: Run, at: float, since: float | None, left: float | None
) -> None:
    assert (elapsed(run, NOW + at), remaining(run, NOW + at)) == (since, left)


def judged(lock: LockDetection, closed: bool) -> Procedure:
    steps = tuple(
        StepRecord(step, step.text, final=NOW if closed and step <= Step.CLOSE else None)
        for step in Step
    )
    return Procedure(steps, settling=False, lock_detection=lock)


SILENT_LATCH = "the latch sensor is silent: confirm or deny steps 2 and 6"

CLOSED = "the door is closed: confirm step 6 once it is locked"

HEARD = LatchView(engaged=True, freshness=Freshness.FRESH)


@pytest.mark.parametrize(
    ("run", "lock", "closed", "latch_view", "words"),
    [
        (RUNNING, LockDetection.SENSOR, False, replace(HEARD, freshness=LOST), SILENT_LATCH)
        for LOST in (Freshness.LOST, Freshness.NEVER)
    ]
    + [
        (RUNNING, LockDetection.SENSOR, True, HEARD, None),
        (RUNNING, LockDetection.REFEREE, True, HEARD, CLOSED),
        (RUNNING, LockDetection.REFEREE, False, HEARD, None),
        (RUNNING, LockDetection.SETTLE, True, HEARD, None),
        (DONE, LockDetection.REFEREE, True, HEARD, None),
    ],
)
def test_the_referee_is_asked_what_no_sensor_can_tell(
    run: Run, lock: LockDetection, closed: bool, latch_view: LatchView, words: str | None
) -> None:
    assert question(run, judged(lock, closed), latch_view) == words
    assert question(run, None, latch_view) is None


@pytest.mark.parametrize(
    ("side", "angle", "words"),
    [
        (Side.CCW, -0.04, "panel at -0.040 rad, against the opening side"),
        (Side.CCW, 0.04, None),
        (Side.CCW, -0.02, None),
        (Side.CW, 0.04, "panel at +0.040 rad, against the opening side"),
        (Side.CW, -0.04, None),
        (Side.CW, None, None),
    ],
)
def test_a_panel_against_the_opening_side_is_a_fault(
    side: Side, angle: float | None, words: str | None
) -> None:
    setup = replace(SETUP, condition=replace(SETUP.condition, opening_side=side))
    view = DoorView(angle, True, Freshness.FRESH, NUMBERS.closed_angle)
    assert panel_fault(view, replace(RUN, setup=setup)) == words
    assert panel_fault(view, Run()) is None


SIMULATED = Announcement("by a node", "two announce it")


@pytest.mark.parametrize(
    ("run", "announced", "words"),
    [
        (
            RUNNING,
            SIMULATED,
            "the testbed is simulated (by a node): void this run after its stop",
        ),
        (RUNNING, replace(SIMULATED, simulated=None), "two announce it"),
        (replace(RUNNING, setup=replace(SETUP, practice=True)), SIMULATED, "two announce it"),
        (
            replace(RUNNING, setup=replace(SETUP, competition="REHEARSAL Cup")),
            SIMULATED,
            "two announce it",
        ),
        (Run(), SIMULATED, "two announce it"),
        (DONE, SIMULATED, "two announce it"),
    ],
)
def test_an_official_run_on_a_simulated_testbed_is_to_be_voided(
    run: Run, announced: Announcement, words: str
) -> None:
    assert state_view.testbed_problem(announced, run) == words


def test_a_message_that_is_judged_late_counts_and_is_not_shown(values: Values) -> None:
    observation = values.core.observation
    message = RawMessage(TOPICS[DOOR], "", b"", 0, round(NOW * 1e9))
    observation.receive(message, recorded=False, shown=False)
    view = next(v for v in observation.sensors.topics((), {}, NOW) if v.topic == TOPICS[DOOR])
    assert (view.received, observation.sensors.door_view(NOW).angle) == (1, None)


def test_what_the_disk_refused_is_tried_again(
    values: Values,
) -> None:
    def kinds_after(seconds: float, silent: float) -> list[Effect]:
        values.now = replace(
            values.now,
            time=values.now.time + seconds,
            workers=replace(values.now.workers, recorder_silent=silent),
        )
        return [*values.core.step(Tick(), values.now)]

    values.ready()
    kinds_after(10.0, 0.0)
    assert kinds_after(1.45, 0.0) == []
    assert kinds_after(0.1, 0.0) == [RetryWriting(results=True)]
    assert kinds_after(1.4, 0.0) == []
    assert kinds_after(-5.0, 0.0) == [RetryWriting(results=True)]  # the clock was stepped back


def test_what_robots_read_is_published_when_it_changes_and_for_each_run(values: Values) -> None:
    def published(effects: Sequence[Effect]) -> list[tuple[str, bool | float]]:
        plain = [e.what for e in effects if isinstance(e, Publish)]
        return [(p.topic, p.value) for p in plain if isinstance(p, PlainValue)]

    first = values.do(SetUp(make_setup()))
    assert published(first) == [(REFEREE_RUNNING_TOPIC, False), (REFEREE_LEVEL_TOPIC, 0)]
    assert published(values.take(Tick(), 0.5)) == []
    opening = values.asked_to_start()
    values.take(RecordingOpened(opening.entries[-1].id, FOLDER, None))
    countdown = make_setup().countdown
    assert published(values.take(Tick(), countdown - 0.1)) == []
    assert published(values.take(Tick(), 0.1)) == [
        (REFEREE_RUNNING_TOPIC, True),
        (REFEREE_ELAPSED_TOPIC, 0.0),
    ]
    assert published(values.take(Tick(), 0.05)) == []
    assert published(values.take(Tick(), 0.1)) == [(REFEREE_ELAPSED_TOPIC, 0.1)]
    assert published(values.do(Abort("stop"))) == [(REFEREE_RUNNING_TOPIC, False)]


def stopped_by_timeout(values: Values) -> Run:
    opening = values.asked_to_start()
    values.take(RecordingOpened(opening.entries[-1].id, FOLDER, None))
    values.take(Tick(), make_setup().countdown)
    declared = [e for e in values.do(DeclareTimeout("gave up")) if isinstance(e, WriteLine)]
    values.take(LineWritten(declared[0].entry.id, None))
    values.take(Tick(), IN_FLIGHT + 0.1)
    run = values.core.current_run.run
    assert (run.phase, run.outcome) == (Phase.STOPPED, Outcome.TIMEOUT)
    return run


def rendered(request: ScoringRequest) -> RenderedResult:
    run, assessment = request.run, request.assessment
    assert run.outcome is not None
    assert assessment is not None
    result, _ = assessment.result(Ending(run.outcome, run.outcome_reason, run.stop), run.rulings)
    past = PastRun.of(run, assessment, run.stop)
    return RenderedResult(request.record, run, result, past, {}, memoryview(b""))


def carried_out(effects: Sequence[Effect]) -> list[Effect]:
    """Without lines and what is published: the silent testbed has faults."""
    return [e for e in effects if not isinstance(e, WriteLine | Publish)]


def scoring(effects: Sequence[Effect]) -> ScoringRequest:
    (wanted,) = (effect for effect in effects if isinstance(effect, Score))
    return wanted.request


def test_after_a_stop_each_step_waits_for_the_one_before_it(values: Values) -> None:
    stopped_by_timeout(values)
    core, state = values.core, values.core.current_run.state
    assert core.records
    assert carried_out(values.take(Tick(), 0.9)) == []
    values.now = replace(values.now, unjudged=1)
    assert carried_out(values.take(Tick(), 0.1)) == []  # what is recorded is judged first
    assert not core.records
    values.now = replace(values.now, unjudged=0)
    assert carried_out(values.take(Tick())) == [CloseRecording()]
    assert (state.recording, state.closing) == (False, True)
    effects = values.take(RecordingClosed(("evidence",), 0))
    request = scoring(effects)
    assert (request.folder, request.missing, request.stored) == (FOLDER, ("evidence",), False)
    assert request.run.issue == 1
    assert (state.closing, state.result.is_missing, state.result.is_settled) == (False, True, False)
    assert core.situation(values.now).scored is False

    scored = rendered(request)
    assert values.take(RunScored(replace(request), scored)) == []  # not what is awaited
    (writing,) = values.take(RunScored(request, scored))
    assert writing == WriteResult(request, scored, state.lines.entries)
    assert values.take(ResultWritten(replace(request, folder=Path("x")), scored, {}, None)) == []
    written = values.take(ResultWritten(request, scored, {"issue": 1}, None))
    assert kinds(written) == ["WriteLine", "Entry", "MakeReports"]
    assert MakeReports(FOLDER) in written
    assert state.result.is_settled
    assert state.result.indicators == scored.result.indicators
    assert core.situation(values.now).scored is True
    effects = values.do(SetUp(make_setup()))
    left = [e for e in effects if isinstance(e, LeaveRun)]
    assert [(e.folder, e.scored, e.problem) for e in left] == [(FOLDER, scored, None)]
    assert ListCutOffRuns() not in effects
    assert core.current_run.state.result.scored is None


def test_a_start_that_is_not_possible_any_more_gives_its_recording_up(values: Values) -> None:
    opening = values.asked_to_start()
    values.now = replace(values.now, testbed=replace(values.now.testbed, other_referee="node b"))
    effects = values.take(RecordingOpened(opening.entries[-1].id, FOLDER, None))
    assert [type(e) for e in carried_out(effects)] == [GiveUpRecording, Answer]
    assert Answer(values.number, "node b") in effects
    assert not any(isinstance(e, WriteLine) for e in effects)
    assert values.core.current_run.run.phase is Phase.READY


def test_a_run_that_cannot_be_scored_is_left_among_those_that_were_cut_off(values: Values) -> None:
    stopped_by_timeout(values)
    values.take(Tick(), 1.0)
    values.take(RecordingClosed((), 0))
    assert Answer(values.number + 1, None) not in values.do(SetUp(make_setup()))
    values.now = replace(values.now, workers=WorkerState(hopeless=True))
    effects = values.do(SetUp(make_setup()))
    assert [e for e in effects if isinstance(e, ListCutOffRuns | Answer)] == [
        ListCutOffRuns(),
        Answer(values.number, None),
    ]


def test_a_result_that_the_disk_refuses_is_shown_and_said_to_be_in_memory_only(
    values: Values,
) -> None:
    stopped_by_timeout(values)
    values.take(Tick(), 1.0)
    effects = values.take(RecordingClosed((), 3))
    told = [e.entry for e in effects if isinstance(e, WriteLine)]
    assert [(e.what, e.details) for e in told] == [(Change.UNRECORDED, {"messages": 3})]
    assert values.core.current_run.run.unrecorded == 3
    request = scoring(effects)
    scored = rendered(request)
    values.take(RunScored(request, scored))
    assert values.take(ResultWritten(request, scored, {}, "no room")) == []
    shown = values.core.snapshot(values.now)
    assert "the result is NOT on disk: no room" in shown.faults
    assert (shown.result, shown.rescoring) == (scored.result, False)
    assert (shown.folder, shown.opened) == (str(FOLDER), False)
    again = values.core.step(Tick(), replace(values.now, time=values.now.time + 2))
    assert RetryWriting(results=True) in again
    wanted = scoring(again)  # files that could not be read may be readable now
    assert not values.core.snapshot(values.now).rescoring
    late = replace(values.now, monotonic=values.now.monotonic + 0.31)
    stale = values.core.snapshot(late)
    assert (stale.rescoring, stale.result) == (True, None)
    ((head,),) = ResultHead().draw_lines(stale, 80)
    assert "being scored again: the one that was here is out of date" in head.text
    (writing,) = values.take(RunScored(wanted, scored))
    assert isinstance(writing, WriteResult)


def test_a_run_that_is_cut_off_is_closed_at_once_and_says_why(values: Values) -> None:
    opening = values.asked_to_start()
    values.take(RecordingOpened(opening.entries[-1].id, FOLDER, None))
    effects = values.take(CutOff("the engine ended"))
    run = values.core.current_run.run
    assert (run.outcome, run.outcome_reason) == (Outcome.INTERRUPTED, "the engine ended")
    assert run.stop == values.now.time
    assert CloseRecording() in effects
    assert not values.core.records
    assert values.take(CutOff("again")) == []


def earlier_run(run: Run, *, out_of_date: bool = False) -> EarlierRun:
    assessment = RECORD.assessment(START)
    ending = run.ending if run.outcome else Ending(Outcome.INTERRUPTED, "cut off", None)
    result, _ = assessment.result(ending)
    past = PastRun.of(run, assessment, run.stop)
    scored = RenderedResult(RECORD, run, result, past, {}, memoryview(b""))
    lines = (Entry(NOW, Origin.REFEREE, "start"), Entry(NOW + 50.0, Origin.SYSTEM, "line"))
    return EarlierRun(Path("results/earlier"), lines, scored, out_of_date)


TIMED_OUT = replace(RUNNING, timeout_at=NOW + 40.0, outcome_reason="gave up")

COMPLETED = replace(DONE, outcome=Outcome.COMPLETED, outcome_reason="done", issue=2)

FAILED = "the program or the machine failed"


@pytest.mark.parametrize(
    ("run", "out_of_date", "invalid", "outcome", "files"),
    [
        (COMPLETED, False, False, (Outcome.COMPLETED, DONE.stop, "done", 2), None),
        (COMPLETED, True, False, (Outcome.COMPLETED, DONE.stop, "done", 2), True),
        (
            replace(COMPLETED, issue=0),
            *(False, False, (Outcome.COMPLETED, DONE.stop, "done", 1), False),
        ),
        (RUNNING, False, False, (Outcome.INTERRUPTED, NOW + 50.0, FAILED, 1), True),
        (RUNNING, False, True, (Outcome.ABORTED, NOW + 50.0, FAILED, 1), True),
        (TIMED_OUT, False, False, (Outcome.TIMEOUT, NOW + 40.0, "gave up", 1), True),
        (TIMED_OUT, False, True, (Outcome.ABORTED, NOW + 50.0, FAILED, 1), True),
    ],
)
def test_an_earlier_run_is_opened_as_it_was_and_a_cut_off_one_is_ended(
    values: Values,
    run: Run,
    out_of_date: bool,
    invalid: bool,
    outcome: tuple[Outcome, float, str, int],
    files: bool | None,
) -> None:
    earlier = earlier_run(run, out_of_date=out_of_date)
    request = OpenEarlierRun(7, earlier, invalid, values.core.current_run.generation)
    assert carried_out(values.take(request)) == [ReopenJournal(request)]
    effects = carried_out(values.take(JournalReopened(request, None, late=False)))
    opened, state = values.core.current_run.run, values.core.current_run.state
    assert (opened.outcome, opened.stop, opened.outcome_reason, opened.issue) == outcome
    assert (state.folder, state.opened, state.recording) == (earlier.folder, earlier, False)
    assert [type(e) for e in effects][:2] == [LeaveRun, KeepJournal]
    assert Answer(7, None) in effects
    if files is None:
        assert state.result.scored is earlier.scored
        assert not any(isinstance(e, Score) for e in effects)
    else:
        wanted = scoring(effects)
        assert (wanted.files, wanted.stored, wanted.folder) == (files, True, earlier.folder)
    assert values.core.snapshot(values.now).opened


@pytest.mark.parametrize(
    ("problem", "late", "meanwhile", "answer", "closes"),
    [
        ("it is open elsewhere", False, "", "it is open elsewhere", []),
        (None, True, "", "the disk took more than 2 s: try again", [CloseJournal]),
        (None, False, "set up", "was set up meanwhile, and stays", [CloseJournal]),
        (None, False, "opened", "another run was opened meanwhile", [CloseJournal]),
    ],
)
def test_an_earlier_run_that_cannot_be_opened_any_more_replaces_nothing(
    values: Values,
    problem: str | None,
    late: bool,
    meanwhile: str,
    answer: str,
    closes: list[type[Effect]],
) -> None:
    generation = values.core.current_run.generation
    request = OpenEarlierRun(7, earlier_run(COMPLETED), False, generation)
    values.take(request)
    if meanwhile == "set up":
        values.ready()
    if meanwhile == "opened":
        other = replace(request, number=8)
        values.take(other)
        values.take(JournalReopened(other, None, late=False))
    before = values.core.current_run.run
    effects = values.take(JournalReopened(request, problem, late))
    assert [type(e) for e in carried_out(effects)] == [*closes, Answer]
    assert answer in str(effects[-1])
    assert values.core.current_run.run == before


def test_what_is_shown_and_checked_is_what_is_known(values: Values) -> None:
    config = EngineConfig(
        *(Path("results"), DEFAULT_MAPPINGS, 5),
        competition="Autumn Cup",
        testbed="Hall A",
    )
    values.core = core = Core(config, MessageTypes())
    arrivals = [*skewed(-0.2), *steady(lambda at: handle(at, 3.0), 0.0)]
    for signal, at, sample, error in arrivals:
        message = RawMessage(TOPICS[signal], "", b"", 0, round((NOW + at) * 1e9))
        core.observation.sensors.receive(message, sample, error)
    seen = Evidence(problem="cannot be read")
    testbed = TestbedState(
        SourceKind.ROS,
        "hall",
        (status(publishers=2),),
        Announcement(),
        other_referee="node b",
        robot_problems={"/robot": "two robots"},
    )
    cut_off = Unfinished("x", 3, "", 1, 1, Phase.RUNNING, None, None, "", 0)
    values.now = now = replace(
        values.now,
        time=NOW,
        taken=NOW,
        judged=NOW,
        testbed=testbed,
        workers=WorkerState(evidence=seen, scoring="it is late", dropped={TOPICS[DOOR]: 4}),
        disk=DiskState(free=3, problem="", journal_problem="no room", late_runs=("run 1",)),
        behind="the engine is behind",
        teams=TeamList({3: "Delft"}),
    )
    values.take(CutOffRunsListed((cut_off,)))
    shown = core.snapshot(now, others=["a", None])
    assert (shown.source_kind, shown.source_label, shown.time) == (SourceKind.ROS, "hall", NOW)
    assert (shown.competition, shown.testbed, shown.evidence) == ("Autumn Cup", "Hall A", seen)
    assert (shown.teams, shown.unfinished, shown.disk_free) == (now.teams, (cut_off,), 3)
    assert (shown.folder, shown.opened, shown.result, shown.result_source) == (
        *(None, False, None, None),
    )
    view = next(v for v in shown.topics if v.topic == TOPICS[DOOR])
    assert (view.publishers, view.dropped) == (2, 4)
    assert list(shown.faults)[:3] == ["no room", "it is late", "run 1"]
    assert {"another referee: node b", "the engine is behind", "/robot: two robots", "a"} < set(
        shown.faults
    )
    checks = {check.name: check for check in shown.checks}
    assert checks[CheckName.DISK].reason == "make room on the disk: 3 B free, 5 B needed"
    assert checks[CheckName.HANDLE].finding == "not yet done since the engine started"
    assert checks[CheckName.CLOCK].state is CheckState.FAILED
    assert checks[CheckName.REFEREE].finding == "node b"
    assert core.situation(now).rest_force == NUMBERS.touch_force / 2
    assert core.situation(now).refused == "no room"
