"""Every act in every phase: possible or refused with words."""

from __future__ import annotations

from dataclasses import replace

import pytest

from madrob_console.referee.acts import (
    ACTS,
    Abort,
    AcceptFalseStart,
    Act,
    AddNote,
    ConfirmPose,
    DeclareTimeout,
    Finalise,
    MarkIncident,
    Reissue,
    RestartCountdown,
    Rule,
    SetUp,
    Situation,
    Start,
    Waive,
    WithdrawIncident,
    ZeroHandle,
)
from madrob_console.referee.preflight import Check, CheckState
from madrob_console.referee.run import (
    CheckName,
    FalseStart,
    Incident,
    IncidentKind,
    Phase,
    Run,
    RunSetup,
    TeamWord,
)
from madrob_console.referee.transitions import begin_countdown, begin_run, stop
from scoring.protocol import BenchmarkType, Condition, EventName, Outcome, Side, StartPose, Step

SETUP = RunSetup(
    subject=3,
    team="Delft",
    run_number=2,
    condition=Condition(BenchmarkType.NO_FORCE, Side.CCW, Side.CCW),
    start_pose=StartPose(1.5, 0.0, 180.0),
    referee="R. Eferee",
)
READY = Run(Phase.READY, SETUP)
COUNTDOWN = begin_countdown(READY, 100.0)
RUNNING = begin_run(COUNTDOWN)
STOPPED = stop(RUNNING, Outcome.COMPLETED, 120.0, "all six steps done")
RUNS = {
    Phase.IDLE: Run(),
    Phase.READY: READY,
    Phase.COUNTDOWN: replace(COUNTDOWN, false_starts=(FalseStart(101.0, EventName.DOOR_OPENS),)),
    Phase.RUNNING: RUNNING,
    Phase.STOPPED: replace(STOPPED, incidents=(Incident(110.0, IncidentKind.FALL),)),
    Phase.FINAL: replace(STOPPED, phase=Phase.FINAL),
}
FAILED = Check(CheckName.DOOR, CheckState.FAILED, "angle +0.500 rad")

POSSIBLE: list[tuple[Act, set[Phase]]] = [
    (SetUp(SETUP), {Phase.IDLE, Phase.READY, Phase.STOPPED, Phase.FINAL}),
    (ConfirmPose(), {Phase.READY}),
    (ZeroHandle(), {Phase.IDLE, Phase.READY, Phase.FINAL}),
    (Waive(CheckName.DOOR, "it is warped"), {Phase.READY}),
    (Start(), {Phase.READY}),
    (RestartCountdown(), {Phase.COUNTDOWN}),
    (AcceptFalseStart("wind"), {Phase.COUNTDOWN}),
    (Abort("fire"), {Phase.COUNTDOWN, Phase.RUNNING}),
    (DeclareTimeout("gave up"), {Phase.RUNNING}),
    (Rule(Step.TOUCH, confirmed=True, reason="seen"), {Phase.RUNNING, Phase.STOPPED}),
    (
        MarkIncident(IncidentKind.COLLISION),
        {Phase.COUNTDOWN, Phase.RUNNING, Phase.STOPPED},
    ),
    (WithdrawIncident("by mistake"), {Phase.STOPPED}),  # it has one to withdraw
    (AddNote("slow"), set(Phase) - {Phase.IDLE}),
    (Finalise(TeamWord.PROTESTED, "R. Eferee"), {Phase.STOPPED}),
    (Reissue("appeal"), {Phase.FINAL}),
]


def situation(run: Run, *checks: Check) -> Situation:
    return Situation(run, checks, handle_mean=5.9, scored=True)


def test_all_acts_are_here() -> None:
    assert [type(act) for act, _ in POSSIBLE] == list(ACTS)


@pytest.mark.parametrize("phase", list(Phase))
@pytest.mark.parametrize(("act", "phases"), POSSIBLE, ids=lambda x: getattr(x, "name", ""))
def test_an_act_is_possible_in_its_phases_and_refused_with_words_elsewhere(
    act: Act, phases: set[Phase], phase: Phase
) -> None:
    checks = (FAILED,) if isinstance(act, Waive) else ()
    refusal = act.refusal(situation(RUNS[phase], *checks))
    if phase in phases:
        assert refusal is None
        act.apply(situation(RUNS[phase], *checks), 130.0)
    else:
        assert refusal


def test_start_needs_every_check_and_says_which_fails() -> None:
    assert Start().refusal(situation(READY, FAILED)) == "door closed: angle +0.500 rad"
    unknown = replace(FAILED, state=CheckState.NO_DATA, reason="no door angle now")
    assert Start().refusal(situation(READY, unknown)) == "door closed: no door angle now"
    waived = replace(FAILED, state=CheckState.WAIVED)
    assert Start().refusal(situation(READY, waived)) is None


def test_a_countdown_is_never_shorter_than_the_pre_roll() -> None:
    quick = replace(READY, setup=replace(SETUP, countdown=0.0))
    assert begin_countdown(quick, 100.0).start == 101.0
    assert COUNTDOWN.start == 105.0


def test_the_next_run_is_clean_but_for_the_handle_zero() -> None:
    used = replace(STOPPED, handle_zero=5.9, pose_confirmed=True, issue=1)
    fresh = SetUp(SETUP).apply(situation(used), 200.0)
    assert fresh == Run(Phase.READY, SETUP, handle_zero=5.9)


def test_the_result_has_to_be_written_before_the_next_run() -> None:
    assert SetUp(SETUP).refusal(Situation(STOPPED, scored=False))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"start_pose": StartPose(-1.0, 0, 0)}, "CCW side"),
        ({"start_pose": StartPose(0.0, 0, 0)}, "threshold"),
        ({"start_pose": StartPose(1.5, float("nan"), 0)}, "start pose"),
        ({"start_pose": StartPose(float("inf"), 0, 0)}, "start pose"),
        ({"subject": 0}, "subject"),
        ({"run_number": 1000}, "run number"),
        ({"timeout": 0.0}, "timeout"),
        ({"countdown": -1.0}, "countdown"),
    ],
)
def test_a_bad_setup_is_refused_naming_the_field(change: dict[str, object], words: str) -> None:
    refusal = SetUp(replace(SETUP, **change)).refusal(situation(Run()))  # type: ignore[arg-type]
    assert refusal is not None
    assert words in refusal


@pytest.mark.parametrize(
    ("act", "run"),
    [
        (Waive(CheckName.DOOR, " "), READY),
        (AcceptFalseStart(""), RUNS[Phase.COUNTDOWN]),
        (Rule(Step.CROSS, confirmed=False, reason=""), RUNNING),
        (AddNote("  "), RUNNING),
        (Finalise(TeamWord.ACKNOWLEDGED, ""), STOPPED),
        (Reissue(""), RUNS[Phase.FINAL]),
    ],
)
def test_an_act_without_its_reason_is_refused(act: Act, run: Run) -> None:
    assert act.refusal(situation(run, FAILED))


def test_zeroing_needs_fresh_data() -> None:
    assert ZeroHandle().refusal(Situation(READY, handle_mean=None)) == "no fresh handle force"


def test_a_reissue_keeps_rulings_and_counts_up() -> None:
    ruled = Rule(Step.CROSS, confirmed=False, reason="arm").apply(situation(STOPPED), 130.0)
    final = replace(ruled, phase=Phase.FINAL, issue=1)
    again = Reissue("appeal").apply(situation(final), 140.0)
    assert (again.phase, again.issue, again.rulings) == (Phase.STOPPED, 2, ruled.rulings)


def test_a_declared_timeout_counts_from_its_instant() -> None:
    declared = DeclareTimeout("gave up").apply(situation(RUNNING), 112.0)
    assert (declared.phase, declared.timeout_at) == (Phase.RUNNING, 112.0)
    assert DeclareTimeout("again").refusal(situation(declared))


def test_an_incident_is_withdrawn_and_stays_on_record() -> None:
    run = replace(
        STOPPED, incidents=(Incident(1.0, IncidentKind.FALL), Incident(2.0, IncidentKind.OTHER))
    )
    once = WithdrawIncident("a shadow").apply(situation(run), 3.0)
    assert [mark.withdrawn for mark in once.incidents] == [None, "a shadow"]
    twice = WithdrawIncident("no fall").apply(situation(once), 4.0)
    assert [mark.withdrawn for mark in twice.incidents] == ["no fall", "a shadow"]
    assert WithdrawIncident("?").refusal(situation(twice)) == "there is no incident to withdraw"
