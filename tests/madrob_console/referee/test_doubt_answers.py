"""What is doubted of a result waits for the referee, whose answer stands beside it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from madrob_console.referee.acts import (
    AcceptDoubts,
    Finalise,
    Situation,
    TakeBack,
    act_details,
    act_named,
)
from madrob_console.referee.acts.take_back import last_decision
from madrob_console.referee.flags import (
    LONGEST_WORDS,
    Flag,
    FlagKind,
    FlagWeight,
    flags,
    undecided,
)
from madrob_console.referee.on_record import AcceptedDoubts, DecisionKind, TeamWord, Voiding
from madrob_console.referee.questions import Ask, Pick
from madrob_console.referee.run import Run
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
from scoring.result import Indicator
from tests.madrob_console.referee.test_acts import STOPPED
from tests.madrob_console.referee.test_amending import View

TOUCH = "the touch rests on 1 sample"
JITTER = "the stamps jitter by 2.1 ms"
TIME = IndicatorName.TIME_TO_HANDLE
PASSAGE = IndicatorName.PASSAGE_TIME
SMOOTHNESS = IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION


def doubted(**by_name: tuple[str, ...]) -> dict[IndicatorName, Indicator]:
    """All indicators, some of them doubted."""
    return {
        name: replace(Indicator.of(name, 4), doubts=by_name.get(name, ())) for name in IndicatorName
    }


RESULT = doubted(time_to_handle=(TOUCH,), passage_time=(TOUCH,))


def situation(run: Run = STOPPED, **by_name: tuple[str, ...]) -> Situation:
    return Situation(run, scored=True, indicators=doubted(**by_name) if by_name else RESULT)


def accepted(run: Run, *names: IndicatorName, words: str = TOUCH) -> Run:
    act = AcceptDoubts(dict.fromkeys(names, (words,)), "seen on video: right")
    return act.apply(situation(run), 130.0)


def found(run: Run, **by_name: tuple[str, ...]) -> tuple[Flag, ...]:
    return flags(run, indicators=doubted(**by_name) if by_name else RESULT)


def test_what_is_doubted_is_one_flag_that_waits_for_the_referee() -> None:
    (flag,) = found(
        STOPPED, time_to_handle=(TOUCH,), smoothness_of_door_actuation=(JITTER, "it stepped")
    )
    words = "doubted: time to handle, smoothness of door actuation (3 doubts UNDECIDED)"
    assert flag == Flag(FlagKind.DOUBT, words, FlagWeight.CAUTION, undecided=True)
    (flag,) = found(STOPPED)
    assert flag.words == "doubted: time to handle, passage time (1 doubt UNDECIDED)"


def test_a_result_all_of_which_is_doubted_has_a_flag_that_can_be_read() -> None:
    everything = {name.value: (TOUCH, JITTER) for name in IndicatorName}
    (flag,) = found(STOPPED, **everything)
    assert len(flag.words) <= LONGEST_WORDS
    assert flag.words.endswith("passage time and 4 more (2 doubts UNDECIDED)")


def test_an_accepted_doubt_stays_as_a_remark_with_its_reason() -> None:
    run = accepted(STOPPED, TIME, PASSAGE)
    (flag,) = found(run)
    words = "doubt accepted: time to handle, passage time (seen on video: right)"
    assert flag == Flag(FlagKind.DOUBT, words, FlagWeight.REMARK)
    assert RESULT[TIME].doubts == (TOUCH,)


def test_accepted_for_one_indicator_it_waits_on_the_others() -> None:
    waiting, remark = found(accepted(STOPPED, TIME))
    assert waiting.words == "doubted: passage time (1 doubt UNDECIDED)"
    assert remark.words == "doubt accepted: time to handle (seen on video: right)"


def test_a_new_doubt_of_a_later_issue_waits_again() -> None:
    run = accepted(STOPPED, TIME, PASSAGE)
    waiting, _ = found(run, time_to_handle=(TOUCH, JITTER), passage_time=(TOUCH,))
    assert waiting.words == "doubted: time to handle (1 doubt UNDECIDED)"
    (other,) = found(run, time_to_handle=(JITTER,))
    assert other.undecided
    assert found(run, smoothness_of_door_actuation=()) == ()


@pytest.mark.parametrize(
    "run",
    [
        replace(STOPPED, outcome=Outcome.ABORTED),
        replace(STOPPED, voided=Voiding(170.0, "the door was jammed", "Ada")),
    ],
)
def test_of_a_run_that_counts_nowhere_no_doubt_waits(run: Run) -> None:
    assert undecided(found(run)) == ()


def test_a_doubt_is_not_signed_in_silence() -> None:
    silent = Finalise(TeamWord.ACKNOWLEDGED, "Ada")
    words = "doubted: time to handle, passage time (1 doubt UNDECIDED)"
    assert silent.refusal(situation()) == f"decide it first, or sign it knowing so: {words}"
    assert replace(silent, undecided=(words,)).refusal(situation()) is None
    assert silent.refusal(situation(accepted(STOPPED, TIME, PASSAGE))) is None
    view = View(STOPPED, flags=found(STOPPED))
    ask = Finalise.ask(view, "f")
    first = ask.questions[0]
    assert isinstance(first, Pick)
    assert f"! {words}: d accepts it with a reason" in first.listed


def test_accepting_is_refused_with_words() -> None:
    act = AcceptDoubts({TIME: (TOUCH,)}, "seen on video: right")
    assert act.refusal(situation()) is None
    assert replace(act, reason=" ").refusal(situation()) == "accepting a doubt needs a reason"
    other = "what is doubted is something else by now: look again"
    assert act.refusal(situation(passage_time=(TOUCH,))) == other
    assert replace(act, doubts={}).refusal(situation()) == "accepting doubts needs one that waits"
    none = "no doubt waits for the referee"
    assert act.refusal(situation(accepted(STOPPED, TIME, PASSAGE))) == none
    unwritten = Situation(STOPPED, scored=False)
    assert act.refusal(unwritten) == "the result is being written"


def test_the_answer_is_taken_back_and_the_doubt_waits_again() -> None:
    run = accepted(accepted(STOPPED, TIME), PASSAGE)
    last = last_decision(run)
    assert last is not None
    assert last.words == "doubt accepted: passage time (seen on video: right)"
    back = TakeBack(DecisionKind.DOUBTS, last.time, "my mistake")
    assert back.refusal(situation(run)) is None
    run = back.apply(situation(run), 140.0)
    assert [list(one.doubts) for one in run.accepted_doubts] == [[TIME]]
    assert [flag.words for flag in undecided(found(run))] == [
        "doubted: passage time (1 doubt UNDECIDED)"
    ]


def test_the_dialog_asks_on_which_indicator_and_then_shows_each_doubt_once() -> None:
    ask = AcceptDoubts.ask(View(STOPPED, indicators=RESULT), "d")
    assert isinstance(ask, Ask)
    (which,) = ask.questions
    assert isinstance(which, Pick)
    assert [option.label for option in which.options[1:]] == [
        *("on all of them", "time to handle: 1 doubt", "passage time: 1 doubt")
    ]
    values = [option.value for option in which.options]
    on_all, on_passage = ask.make(values[1]), ask.make(values[3])
    assert isinstance(on_all, Ask)
    assert isinstance(on_passage, Ask)
    (why,) = on_all.questions
    assert isinstance(why, Pick)
    assert why.listed == (f"? {TOUCH}",)
    assert on_all.title == "Accept what is doubted of time to handle, passage time"
    every = AcceptDoubts({TIME: (TOUCH,), PASSAGE: (TOUCH,)}, "no effect on the ranking")
    assert on_all.make("no effect on the ranking") == every
    assert on_passage.make("?") == AcceptDoubts({PASSAGE: (TOUCH,)}, "?")


def test_one_doubted_indicator_is_not_asked_for() -> None:
    view = View(STOPPED, indicators=doubted(smoothness_of_door_actuation=(JITTER,)))
    ask = AcceptDoubts.ask(view, "d")
    assert isinstance(ask, Ask)
    (why,) = ask.questions
    assert isinstance(why, Pick)
    assert why.listed == (f"? {JITTER}",)
    assert ask.make("?") == AcceptDoubts({SMOOTHNESS: (JITTER,)}, "?")
    assert AcceptDoubts.ask(View(STOPPED), "d") == "no doubt waits for the referee"


def test_the_journal_tells_what_was_accepted() -> None:
    act = AcceptDoubts({TIME: (TOUCH,)}, "seen on video: right")
    assert act_named(act.name, act_details(act)) == act
    run = act.apply(situation(), 130.0)
    stood = AcceptedDoubts(130.0, act.reason, STOPPED.referee, {TIME: (TOUCH,)})
    assert run.accepted_doubts == (stood,)
