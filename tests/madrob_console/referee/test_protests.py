"""A protest is open until it is decided or withdrawn, and so is the result."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from madrob_console.referee.acts import (
    AcceptDoubts,
    Act,
    DecideProtest,
    FileProtest,
    Finalise,
    Rule,
    Situation,
    TakeBack,
    WithdrawProtest,
    act_details,
    act_named,
)
from madrob_console.referee.acts.act import Ask, Pick, Write
from madrob_console.referee.acts.correct import last_decision
from madrob_console.referee.acts.protest import MOST_PROTESTS
from madrob_console.referee.flags import LONGEST_WORDS, Flag, FlagKind, FlagWeight, flags, undecided
from madrob_console.referee.records import (
    AcceptedDoubts,
    DecisionKind,
    ProtestEnd,
    TeamWord,
    Voiding,
    open_protests,
)
from madrob_console.referee.run import Phase, Run
from scoring.indicator_table import IndicatorName
from scoring.procedure import StepRecord
from scoring.protocol import Outcome, Step
from scoring.result import Indicator
from tests.madrob_console.referee.test_acts import STOPPED
from tests.madrob_console.referee.test_amending import FINAL, View

SLOW = FileProtest("the robot was through earlier", "Graz", "step 4", 12.5)
UPHELD = DecideProtest(1, ProtestEnd.UPHELD, "seen on video", "R. Eferee")


def done(run: Run, act: Act, time: float = 200.0) -> Run:
    """The run after an act that the engine carries out."""
    situation = Situation(run, scored=True)
    assert act.refusal(situation) is None
    return act.settled(situation).apply(situation, time)


def refused(run: Run, act: Act) -> str:
    said = act.refusal(Situation(run, scored=True))
    assert said is not None
    return said


def test_a_protest_says_who_what_about_and_when() -> None:
    (protest,) = done(STOPPED, SLOW).protests
    assert STOPPED.start is not None
    assert (protest.number, protest.team, protest.about) == (1, "Graz", "step 4")
    assert protest.text == "the robot was through earlier"
    assert protest.at == STOPPED.start + 12.5
    assert (protest.time, protest.open) == (200.0, True)


def test_a_final_result_is_open_again_and_its_next_issue_has_a_number() -> None:
    run = done(FINAL, SLOW)
    assert (run.phase, run.closure, run.issue) == (Phase.STOPPED, None, 2)


def test_nothing_is_signed_over_an_open_protest_in_silence() -> None:
    run = done(STOPPED, SLOW)
    sign = Finalise(TeamWord.ABSENT, "R. Eferee")
    (flag,) = undecided(flags(run))
    assert (flag.kind, flag.weight) == (FlagKind.PROTEST, FlagWeight.ALARM)
    assert "protest 1 (step 4) OPEN" in refused(run, sign)
    knowing = replace(sign, undecided=(flag.words,))
    final = done(run, knowing)
    assert open_protests(final.protests)
    decided = done(final, UPHELD, 300.0)
    assert (decided.phase, decided.closure, decided.issue) == (Phase.STOPPED, None, 2)
    assert [one.what for one in decided.reissues] == ["decide protest"]
    assert done(decided, sign).phase is Phase.FINAL


@pytest.mark.parametrize("outcome", [Outcome.ABORTED, Outcome.COMPLETED])
def test_a_run_that_does_not_count_can_be_protested_too(outcome: Outcome) -> None:
    run = done(replace(STOPPED, outcome=outcome), SLOW)
    assert FlagKind.PROTEST in {flag.kind for flag in undecided(flags(run))}


def test_a_decision_needs_words_a_name_and_an_open_protest() -> None:
    run = done(STOPPED, SLOW)
    assert refused(run, replace(UPHELD, reason=" ")) == "a decision needs words"
    assert refused(run, replace(UPHELD, referee="")) == "a decision needs the referee's name"
    assert refused(run, replace(UPHELD, number=2)) == "protest 2 is not open: look again"
    withdrawn = replace(UPHELD, end=ProtestEnd.WITHDRAWN)
    assert "withdrawn by the team" in refused(run, withdrawn)
    after = done(run, UPHELD, 300.0)
    assert refused(after, UPHELD) == "no protest is open"
    assert after.protests[0].answer is not None
    assert after.protests[0].answer.reason == "seen on video"
    (flag,) = flags(after)
    assert flag.words == "protest 1 (step 4) upheld (seen on video)"
    assert not flag.undecided


def test_a_team_can_withdraw_its_protest_and_file_another() -> None:
    run = done(STOPPED, SLOW)
    run = done(run, WithdrawProtest(1, "satisfied"), 210.0)
    assert not open_protests(run.protests)
    assert [flag.weight for flag in flags(run)] == [FlagWeight.REMARK]
    run = done(run, SLOW, 220.0)
    assert [one.number for one in open_protests(run.protests)] == [2]


@pytest.mark.parametrize("run", [STOPPED, FINAL], ids=["open", "final"])
def test_a_decision_that_is_taken_back_leaves_the_protest_open_as_it_was(run: Run) -> None:
    filed = done(run, SLOW)
    decided = done(filed, UPHELD, 300.0)
    last = last_decision(decided)
    assert last is not None
    assert last.words == "protest 1 (step 4) upheld (seen on video)"
    back = done(decided, TakeBack(last.kind, last.time, "another video"), 310.0)
    assert back.protests == filed.protests
    assert back.taken_back[-1].kind is DecisionKind.PROTEST


def test_a_decision_of_a_final_result_can_be_taken_back() -> None:
    decided = done(done(STOPPED, SLOW), UPHELD, 300.0)
    final = done(decided, Finalise(TeamWord.ABSENT, "R. Eferee"))
    back = done(final, TakeBack(DecisionKind.PROTEST, 300.0, "another video"), 310.0)
    assert (back.phase, back.issue) == (Phase.STOPPED, 2)
    assert open_protests(back.protests)


def listed_before_it_is_final(run: Run) -> str:
    asked = Finalise.ask_questions(View(run), "f")
    assert isinstance(asked, Ask)
    assert isinstance(asked.questions[0], Pick)
    return "\n".join(asked.questions[0].listed)


def test_an_upheld_protest_that_changed_nothing_is_named_before_the_signature() -> None:
    filed = done(STOPPED, SLOW)
    hint = "protest 1 (step 4) was upheld: nothing was changed since"
    assert hint in listed_before_it_is_final(done(filed, UPHELD, 300.0))
    rejected = replace(UPHELD, end=ProtestEnd.REJECTED)
    assert hint not in listed_before_it_is_final(done(filed, rejected, 300.0))
    ruled = done(filed, Rule(Step.CROSS, confirmed=True, reason="video"), 290.0)
    assert hint not in listed_before_it_is_final(done(ruled, UPHELD, 300.0))


def test_a_time_outside_the_recording_is_refused_where_it_is_typed() -> None:
    run = replace(STOPPED, countdown_began=95.0, start=100.0, stop=130.0)
    asked = FileProtest.ask_questions(View(run), "P")
    assert isinstance(asked, Ask)
    when = asked.make("time")
    assert isinstance(when, Ask)
    for typed in ("99999", "-66", "91"):
        said = when.make(typed)
        assert isinstance(said, str)
        assert said.startswith("the recording goes from -5 s to 30 s: ")
    for typed in ("12.5", "-65", "1:30"):
        assert isinstance(when.make(typed), Ask)


@pytest.mark.parametrize(
    ("act", "words"),
    [
        (replace(SLOW, text=" "), "a protest needs the team's words"),
        (replace(SLOW, team=""), "a protest needs the name of the team"),
        (replace(SLOW, text="x" * 2001), "at most 2000 characters"),
        (replace(SLOW, after_start=float("nan")), "more than 60 s outside it"),
    ],
)
def test_what_is_no_protest_is_refused_with_words(act: FileProtest, words: str) -> None:
    assert words in refused(STOPPED, act)


def test_a_run_has_a_bounded_number_of_protests() -> None:
    run = STOPPED
    for _ in range(MOST_PROTESTS):
        run = done(run, SLOW)
    assert "add a note" in refused(run, SLOW)


def answered(asked: object, *answers: str) -> Any:  # noqa: ANN401  whatever was asked
    """What the answers to a dialog bring about."""
    assert isinstance(asked, Ask)
    return asked.make(*answers)


def test_the_dialog_asks_what_about_then_who_and_what_they_say() -> None:
    assert STOPPED.start is not None
    steps = (StepRecord(Step.CROSS, Step.CROSS.text, final=STOPPED.start + 7.0),)
    ask = FileProtest.ask_questions(View(STOPPED, steps=steps), "P")
    about = "step 4: cross the threshold"
    act = answered(answered(ask, about), "Graz", "through earlier")
    assert act == FileProtest("through earlier", "Graz", about, 7.0)
    typed = answered(answered(answered(ask, "time"), "1:05"), "Graz", "x")
    assert (typed.about, typed.after_start) == ("65.000 s", 65.0)
    assert "is no time" in answered(answered(ask, "time"), "soon")
    indicator = answered(answered(answered(ask, "indicator"), "execution time"), "Graz", "x")
    assert (indicator.about, indicator.after_start) == ("execution time", None)


def test_the_same_key_decides_and_withdraws_while_a_protest_is_open() -> None:
    view = View(done(STOPPED, SLOW))
    ask = FileProtest.ask_questions(view, "P")
    assert isinstance(ask, Ask)
    assert isinstance(ask.questions[0], Pick)
    assert "the robot was through earlier" in ask.questions[0].listed[0]
    decision = DecideProtest(1, ProtestEnd.REJECTED, "no", view.run.referee)
    assert answered(answered(ask, "decide"), "rejected", "no") == decision
    assert answered(answered(ask, "withdraw"), "satisfied") == WithdrawProtest(1, "satisfied")
    which = DecideProtest.ask_questions(View(done(view.run, SLOW)), "P")
    assert answered(answered(which, "2"), "upheld", "yes").number == 2


def test_who_decides_is_asked_where_no_referee_is_known() -> None:
    assert STOPPED.setup is not None
    nameless = replace(STOPPED, setup=replace(STOPPED.setup, referee=""))
    ask = DecideProtest.ask_questions(View(done(nameless, SLOW)), "P")
    assert isinstance(ask, Ask)
    assert isinstance(ask.questions[-1], Write)
    assert answered(ask, "upheld", "seen", "Ada").referee == "Ada"


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
    assert flag == Flag(FlagKind.DOUBT, words, FlagWeight.ALARM, undecided=True)
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
    ask = Finalise.ask_questions(view, "f")
    first = ask.questions[0]
    assert isinstance(first, Pick)
    assert f"! {words}" in first.listed


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
    ask = AcceptDoubts.ask_questions(View(STOPPED, indicators=RESULT), "d")
    assert isinstance(ask, Ask)
    (which,) = ask.questions
    assert isinstance(which, Pick)
    assert [option.label for option in which.options] == [
        *("on all of them", "time to handle: 1 doubt", "passage time: 1 doubt")
    ]
    values = [option.value for option in which.options]
    on_all, on_passage = ask.make(values[0]), ask.make(values[2])
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
    ask = AcceptDoubts.ask_questions(view, "d")
    assert isinstance(ask, Ask)
    (why,) = ask.questions
    assert isinstance(why, Pick)
    assert why.listed == (f"? {JITTER}",)
    assert ask.make("?") == AcceptDoubts({SMOOTHNESS: (JITTER,)}, "?")
    assert AcceptDoubts.ask_questions(View(STOPPED), "d") == "no doubt waits for the referee"


def test_the_journal_tells_what_was_accepted() -> None:
    act = AcceptDoubts({TIME: (TOUCH,)}, "seen on video: right")
    assert act_named(act.name, act_details(act)) == act
    run = act.apply(situation(), 130.0)
    stood = AcceptedDoubts(130.0, act.reason, STOPPED.referee, {TIME: (TOUCH,)})
    assert run.accepted_doubts == (stood,)
