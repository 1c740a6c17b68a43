"""What a result's reader has to know at once, and what is still undecided."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import pytest

from madrob_console.kinds import SourceKind
from madrob_console.referee.acts import Finalise, Situation
from madrob_console.referee.flags import (
    LONGEST_WORDS,
    Flag,
    FlagKind,
    FlagWeight,
    flags,
    undecided,
    worst,
)
from madrob_console.referee.on_record import (
    CheckName,
    Closure,
    FalseStart,
    Incident,
    IncidentKind,
    TeamWord,
    Voiding,
    Waiver,
)
from madrob_console.referee.on_record import TestbedFault as Fault
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.transitions import decide_false_starts
from scoring.events import Evidence
from scoring.procedure import Procedure, Ruling, follow_procedure
from scoring.protocol import EventName, LockDetection, Outcome, Step
from tests.madrob_console.ui.setups import a_setup

RUN = Run(start=100.0, stop=150.0, outcome=Outcome.COMPLETED)
TOUCH = FalseStart(98.0, EventName.HANDLE_IS_TOUCHED)


def ruled(step: Step, confirmed: bool | None) -> Ruling:
    return Ruling(step, confirmed, 160.0, "seen on video", "Ada")


NAMED = replace(a_setup(), team_reason="renamed since")
"""The team has another name than in the list."""


@pytest.mark.parametrize(
    ("run", "words", "weight"),
    [
        (
            replace(RUN, setup=NAMED),
            "team's name other than the list's: renamed since",
            FlagWeight.CAUTION,
        ),
        (
            replace(RUN, false_starts=(TOUCH,)),
            "1 false start UNDECIDED (handle touched)",
            FlagWeight.ALARM,
        ),
        (
            replace(RUN, false_starts=(TOUCH, FalseStart(99.0, EventName.DOOR_OPENS), TOUCH)),
            "3 false starts UNDECIDED (first: handle touched)",
            FlagWeight.ALARM,
        ),
        (
            replace(RUN, false_starts=(replace(TOUCH, accepted="nothing gained"),)),
            "1 false start accepted",
            FlagWeight.REMARK,
        ),
        (
            replace(RUN, faults=(Fault(99.0, "lost"), Fault(101.0, "lost again"))),
            "2 testbed faults",
            FlagWeight.CAUTION,
        ),
        (
            replace(RUN, unrecorded=1),
            "the recording lacks 1 message: the result cannot be made again from it",
            FlagWeight.CAUTION,
        ),
        (
            replace(RUN, incidents=(Incident(140.0, IncidentKind.FALL),)),
            "1 incident (fall)",
            FlagWeight.CAUTION,
        ),
        (
            replace(RUN, waivers=(Waiver(CheckName.CLOCK, "known", "Ada", 90.0),)),
            "waived: clock skew",
            FlagWeight.CAUTION,
        ),
        (
            replace(RUN, rulings=(ruled(Step.OPEN, False), ruled(Step.CROSS, False))),
            "steps 3, 4 denied",
            FlagWeight.CAUTION,
        ),
        (
            replace(RUN, rulings=(ruled(Step.CROSS, False), ruled(Step.CROSS, True))),
            "step 4 confirmed",
            FlagWeight.CAUTION,
        ),
        (
            replace(RUN, closure=Closure(170.0, "Ada", TeamWord.PROTESTED)),
            "PROTESTED by the team",
            FlagWeight.CAUTION,
        ),
    ],
)
def test_what_a_decision_hangs_on_is_a_flag(run: Run, words: str, weight: FlagWeight) -> None:
    (flag,) = flags(run)
    assert (flag.words, flag.weight) == (words, weight)
    assert flag.undecided == ("UNDECIDED" in words)


def test_what_was_taken_back_is_no_flag() -> None:
    fall = Incident(140.0, IncidentKind.FALL, withdrawn="it was the other robot")
    rulings = (ruled(Step.CROSS, False), ruled(Step.CROSS, None))
    acknowledged = Closure(170.0, "Ada", TeamWord.ACKNOWLEDGED)
    run = replace(RUN, incidents=(fall,), rulings=rulings, closure=acknowledged)
    assert flags(run, source=SourceKind.ROS) == ()
    assert worst(()) is None


def test_a_run_beyond_the_plan_is_flagged() -> None:
    setup = replace(a_setup(), out_of_plan=True)
    (flag,) = flags(replace(RUN, setup=setup), source=SourceKind.ROS)
    words = "out of plan: more than the competition planned"
    assert flag == Flag(FlagKind.OUT_OF_PLAN, words, FlagWeight.CAUTION)


def test_a_result_of_no_real_testbed_is_flagged() -> None:
    (flag,) = flags(RUN, source=SourceKind.SIMULATED)
    assert flag == Flag(FlagKind.PRACTICE, "SIMULATED: not an official result", FlagWeight.REMARK)


def locking(mode: LockDetection, *rulings: Ruling) -> Procedure:
    """Five steps done; only the referee can say whether the door is locked."""
    evidence = Evidence(100.0, 150.0, None, (), None, (), latch_before_start=False, crossed=None)
    early = [ruled(step, True) for step in list(Step)[:5]]
    return follow_procedure(
        evidence, lock_detection=mode, settle_time=1.0, rulings=(*early, *rulings)
    )


@pytest.mark.parametrize("mode", [LockDetection.REFEREE, LockDetection.SENSOR])
def test_a_lock_that_only_the_referee_can_judge_is_undecided(mode: LockDetection) -> None:
    found = undecided(flags(RUN, locking(mode).steps))
    assert [flag.kind for flag in found] == [FlagKind.UNDECIDED_STEP]
    assert "step 6 UNDECIDED" in found[0].words
    for verdict in (True, False):
        decided = locking(mode, ruled(Step.LOCK, verdict))
        assert undecided(flags(RUN, decided.steps)) == ()


def test_the_heaviest_flag_comes_first() -> None:
    run = replace(
        RUN,
        false_starts=(replace(TOUCH, accepted="nothing gained"), TOUCH),
        incidents=(Incident(140.0, IncidentKind.FALL),),
    )
    found = flags(run, source=SourceKind.SIMULATED)
    weights = [flag.weight for flag in found]
    assert weights == sorted(weights, key=lambda weight: -weight.rank)
    assert weights[0] is worst(found) is FlagWeight.ALARM
    assert FlagWeight.REMARK.rank < FlagWeight.CAUTION.rank < FlagWeight.ALARM.rank


@pytest.mark.parametrize(
    "run",
    [
        replace(RUN, outcome=Outcome.ABORTED),
        replace(RUN, voided=Voiding(170.0, "the door was jammed", "Ada")),
    ],
)
def test_there_is_nothing_to_decide_on_a_run_that_counts_nowhere(run: Run) -> None:
    touched = replace(run, false_starts=(TOUCH,))
    assert undecided(flags(touched, locking(LockDetection.REFEREE).steps)) == ()


def test_what_somebody_wrote_does_not_make_a_flag_too_long_to_be_read() -> None:
    run = replace(RUN, voided=Voiding(170.0, "why " * 500, "Ada"))
    (flag,) = flags(run)
    assert msgspec.json.decode(msgspec.json.encode(flag), type=Flag) == flag
    assert len(flag.words) <= LONGEST_WORDS


def a_result(run: Run, mode: LockDetection = LockDetection.SETTLE) -> Situation:
    return Situation(run, scored=True, steps=locking(mode).steps)


def test_nothing_undecided_is_signed_in_silence() -> None:
    run = replace(RUN, phase=Phase.STOPPED, false_starts=(TOUCH,))
    silent = Finalise(TeamWord.ACKNOWLEDGED, "Ada")
    refused = silent.refusal(a_result(run, LockDetection.REFEREE))
    assert refused is not None
    assert "1 false start UNDECIDED (handle touched)" in refused
    assert "step 6 UNDECIDED" in refused
    knowing = replace(silent, undecided=("1 false start UNDECIDED (handle touched)",))
    assert knowing.refusal(a_result(run)) is None
    refused = knowing.refusal(a_result(run, LockDetection.REFEREE))
    assert refused is not None
    assert "step 6 UNDECIDED" in refused
    assert "false start" not in refused


def test_what_was_decided_meanwhile_is_not_signed_as_undecided() -> None:
    run = replace(RUN, phase=Phase.STOPPED, false_starts=(TOUCH,))
    knowing = Finalise(TeamWord.ABSENT, "Ada", "", ("1 false start UNDECIDED (handle touched)",))
    decided = decide_false_starts(run, "nothing gained")
    assert knowing.refusal(a_result(decided)) == (
        "what was undecided is decided by now: look again"
    )
    assert Finalise(TeamWord.ABSENT, "Ada").refusal(a_result(decided)) is None


def test_a_flag_of_a_later_version_is_one_that_weighs() -> None:
    later = b'{"kind":"moon","words":"full","weight":"grave","undecided":false}'
    flag = msgspec.json.decode(later, type=Flag)
    assert flag == Flag(FlagKind.OTHER, "full", FlagWeight.ALARM)
