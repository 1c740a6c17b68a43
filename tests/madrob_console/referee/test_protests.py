"""A protest is open until it is decided or withdrawn, and so is the result; so is a doubt."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from madrob_console.referee.acts import (
    AcceptDoubts,
    Act,
    DecideProtest,
    FileProtest,
    Situation,
    TakeBack,
    WithdrawProtest,
)
from madrob_console.referee.acts.correct import last_decision
from madrob_console.referee.acts.protest import outside_recording
from madrob_console.referee.flags import LONGEST_WORDS, Flag, FlagKind, FlagWeight, flags, undecided
from madrob_console.referee.protests import ProtestEnd, open_protests
from madrob_console.referee.records import DecisionKind, Voiding
from madrob_console.referee.run import Phase, Run
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
from scoring.result import Indicator
from tests.madrob_console.referee.test_acts import STOPPED, done
from tests.madrob_console.referee.test_amending import FINAL, SIGN

SLOW = FileProtest("the robot was through earlier", "Graz", "step 4", 12.5)
UPHELD = DecideProtest(1, ProtestEnd.UPHELD, "seen on video", "R. Eferee")
Made = Callable[[], Run]
"""Makes a run by acts, when the test runs."""
VOID = Voiding(170.0, "the door was jammed", "Ada")


def filed(**changes: object) -> Run:
    return replace(done(STOPPED, SLOW), **changes)  # type: ignore[arg-type]


def withdrawn() -> Run:
    return done(filed(), WithdrawProtest(1, "satisfied"), 210.0)


def test_a_protest_is_decided_before_the_result_is_signed() -> None:
    (flag,) = undecided(flags(filed()))
    assert (flag.kind, flag.weight) == (FlagKind.PROTEST, FlagWeight.ALARM)
    assert "protest 1 (step 4) OPEN" in flag.words
    knowing = replace(SIGN, undecided=(flag.words,))
    refused = "a protest is open: decide it first"
    assert knowing.refusal(Situation(filed(), scored=True)) == refused
    decided = done(filed(), UPHELD, 300.0)
    assert SIGN.refusal(Situation(decided, scored=True)) is None
    assert done(decided, SIGN).phase is Phase.FINAL


@pytest.mark.parametrize(
    ("run", "waiting", "words"),
    [
        (filed, [1], ["protest 1 (step 4) OPEN"]),
        (lambda: filed(outcome=Outcome.ABORTED), [1], ["protest 1 (step 4) OPEN"]),
        (lambda: filed(voided=VOID), [1], ["protest 1 (step 4) OPEN", "VOID"]),
        (lambda: done(filed(), UPHELD, 300.0), [], ["protest 1 (step 4) upheld (seen on video)"]),
        (withdrawn, [], ["protest 1 (step 4) withdrawn"]),
        (
            lambda: done(withdrawn(), SLOW, 220.0),
            [2],
            ["protest 2 (step 4) OPEN", "protest 1 (step 4) withdrawn"],
        ),
    ],
)
def test_a_protest_is_a_flag_and_waits_until_it_is_decided_or_withdrawn(
    run: Made, waiting: list[int], words: list[str]
) -> None:
    assert [one.number for one in open_protests(run().protests)] == waiting
    found = flags(run())
    assert [flag.words[: len(say)] for flag, say in zip(found, words, strict=True)] == words
    assert len(undecided(found)) == len(waiting)


@pytest.mark.parametrize(
    ("run", "at", "words"),
    [
        *((STOPPED, at, None) for at in (-65.0, 0.0, 75.0)),
        *(
            (
                STOPPED,
                at,
                f"the recording goes from -5 s to 15 s: {at:g} s is more than 60 s outside it",
            )
            for at in (-65.1, 75.1)
        ),
        (Run(), 60.0, None),
        (Run(), 61.0, "the recording goes from 0 s to 0 s: 61 s is more than 60 s outside it"),
    ],
)
def test_an_instant_in_question_lies_within_the_recording_or_a_minute_of_it(
    run: Run, at: float, words: str | None
) -> None:
    assert outside_recording(at, run) == words
    assert replace(SLOW, after_start=at).refusal(Situation(STOPPED, scored=True)) == (
        words if run is STOPPED else None
    )


@pytest.mark.parametrize("before", [STOPPED, FINAL], ids=["open", "final"])
def test_a_decision_that_is_taken_back_leaves_the_protest_open_as_it_was(before: Run) -> None:
    run = done(before, SLOW)
    decided = done(run, UPHELD, 300.0)
    last = last_decision(decided)
    assert last is not None
    assert last.words == "protest 1 (step 4) upheld (seen on video)"
    back = done(decided, TakeBack(last.kind, last.time, "another video"), 310.0)
    assert back.protests == run.protests
    assert back.taken_back[-1].kind is DecisionKind.PROTEST
    signed = done(done(decided, SIGN), TakeBack(last.kind, last.time, "another video"), 310.0)
    assert (signed.phase, signed.issue) == (Phase.STOPPED, max(1, decided.issue) + 1)
    assert open_protests(signed.protests)


TOUCH = "the touch rests on 1 sample"
JITTER = "the stamps jitter by 2.1 ms"
TIME = IndicatorName.TIME_TO_HANDLE
PASSAGE = IndicatorName.PASSAGE_TIME
SMOOTHNESS = IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION


def doubted(by_name: dict[IndicatorName, tuple[str, ...]]) -> dict[IndicatorName, Indicator]:
    """All indicators, some of them doubted."""
    return {
        name: replace(Indicator.of(name, 4), doubts=by_name.get(name, ())) for name in IndicatorName
    }


BOTH: dict[IndicatorName, tuple[str, ...]] = {TIME: (TOUCH,), PASSAGE: (TOUCH,)}
ACCEPT = AcceptDoubts(BOTH, "seen on video: right")
ON_ONE = replace(ACCEPT, doubts={TIME: (TOUCH,)})


def situation(run: Run = STOPPED) -> Situation:
    return Situation(run, scored=True, indicators=doubted(BOTH))


def not_accepted(**changes: object) -> Run:
    return replace(STOPPED, **changes)  # type: ignore[arg-type]


def all_accepted() -> Run:
    return ACCEPT.apply(situation(), 130.0)


def one_accepted() -> Run:
    return ON_ONE.apply(situation(), 130.0)


REMARK = "doubt accepted: time to handle, passage time (seen on video: right)"
WAITS = "2 values to check: time to handle, passage time"


@pytest.mark.parametrize(
    ("run", "doubts", "words"),
    [
        (
            not_accepted,
            {TIME: (TOUCH,), SMOOTHNESS: (JITTER, "it stepped")},
            ["2 values to check: time to handle, smoothness of door actuation"],
        ),
        (not_accepted, BOTH, [WAITS]),
        (
            not_accepted,
            dict.fromkeys(IndicatorName, (TOUCH, JITTER)),
            [
                (
                    "8 values to check: execution time, time to handle, door occupation time, "
                    "passage time and 4 more"
                )
            ],
        ),
        (all_accepted, BOTH, [REMARK]),
        (
            one_accepted,
            BOTH,
            [
                "1 value to check: passage time",
                "doubt accepted: time to handle (seen on video: right)",
            ],
        ),
        (  # a new doubt of a later issue
            all_accepted,
            BOTH | {TIME: (TOUCH, JITTER)},
            ["1 value to check: time to handle", REMARK],
        ),
        (all_accepted, {TIME: (JITTER,)}, ["1 value to check: time to handle"]),
        (all_accepted, {}, []),
        (lambda: not_accepted(outcome=Outcome.ABORTED), BOTH, []),
        (lambda: not_accepted(voided=VOID), BOTH, ["VOID, does not count (the door was jammed)"]),
    ],
)
def test_a_doubt_is_a_flag_that_waits_for_the_referee_and_stays_as_a_remark(
    run: Made, doubts: dict[IndicatorName, tuple[str, ...]], words: list[str]
) -> None:
    found = flags(run(), indicators=doubted(doubts))
    assert [flag.words for flag in found] == words
    for flag in found:
        assert len(flag.words) <= LONGEST_WORDS
        waits = " to check: " in flag.words
        weight = FlagWeight.ALARM if waits else FlagWeight.REMARK
        void = flag.kind is not FlagKind.DOUBT
        assert void or flag == Flag(FlagKind.DOUBT, flag.words, weight, undecided=waits)


@pytest.mark.parametrize(
    ("act", "here", "words"),
    [
        (ACCEPT, situation, None),
        (replace(ACCEPT, reason=" "), situation, "accepting a doubt needs a reason"),
        (
            ACCEPT,
            lambda: replace(situation(), indicators=doubted({PASSAGE: (TOUCH,)})),
            "what is doubted is something else by now: look again",
        ),
        (replace(ACCEPT, doubts={}), situation, "accepting doubts needs one that waits"),
        (ACCEPT, lambda: situation(all_accepted()), "no doubt waits for the referee"),
        (ACCEPT, lambda: Situation(STOPPED, scored=False), "the result is being written"),
        (SIGN, situation, f"decide it first, or sign it knowing so: {WAITS}"),
        (replace(SIGN, undecided=(WAITS,)), situation, None),
        (SIGN, lambda: situation(all_accepted()), None),
    ],
)
def test_a_doubt_is_accepted_with_a_reason_and_not_signed_in_silence(
    act: Act, here: Callable[[], Situation], words: str | None
) -> None:
    assert act.refusal(here()) == words
