"""What is asked before an act: which keys make which act, and what the referee reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, cast

import pytest

from madrob_console.engine.snapshot import RightToAct
from madrob_console.referee.acts import (
    Abort,
    AcceptDoubts,
    Act,
    AddNote,
    Correct,
    DecideProtest,
    FileProtest,
    Finalise,
    MarkIncident,
    Reissue,
    RestartCountdown,
    Rule,
    TakeBack,
    Waive,
    WithdrawProtest,
)
from madrob_console.referee.checks import Check
from madrob_console.referee.flags import Flag, FlagKind, FlagWeight
from madrob_console.referee.protests import ProtestAnswer, ProtestEnd
from madrob_console.referee.records import CheckName, DecisionKind, IncidentKind, TeamWord
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.team_list import NO_TEAMS, TeamList
from madrob_console.ui.keys.key_table import KEYS, with_caps
from madrob_console.ui.keys.questions import NO_REASON, Ask, Option, Pick, Write, ask_why
from madrob_console.ui.keys.result_questions import ask_decision, ask_void_instead, ask_withdrawal
from scoring.indicator_table import IndicatorName
from scoring.procedure import StepRecord
from scoring.protocol import BenchmarkType, Side, Step
from scoring.result import Indicator
from tests.madrob_console.referee.test_acts import (
    ADA,
    COUNTDOWN,
    DONE,
    DOUBTED,
    FAILED,
    FIXED,
    ONE_SAMPLE,
    PROTEST,
    PROTESTED,
    READY,
    RUNNING,
    RUNS,
    SETUP,
    STOPPED,
)

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot

pytestmark = pytest.mark.pure


@dataclass
class View:
    """What a screen shows of a run."""

    run: Run
    checks: tuple[Check, ...] = ()
    steps: tuple[StepRecord, ...] = ()
    flags: tuple[Flag, ...] = ()
    teams: TeamList = NO_TEAMS
    elapsed: float | None = None
    indicators: Mapping[IndicatorName, Indicator] = field(default_factory=dict)
    right: RightToAct = field(default_factory=RightToAct)
    practice: bool = False


CROSSED = (StepRecord(Step.CROSS, Step.CROSS.text, sensors=111.0, final=112.0),)
TWO = replace(PROTESTED, protests=(PROTEST, replace(PROTEST, number=2)))
NAMELESS = replace(PROTESTED, setup=replace(SETUP, referee=""))
CW = replace(SETUP.condition, starting_side=Side.CW)
TO_OPEN = replace(SETUP.condition, opening_side=Side.CW)
WIND = replace(SETUP.condition, benchmark_type=BenchmarkType.WIND_RAMP)
TIME, PASSAGE = DOUBTED
OPEN_DOOR = View(READY, (FAILED, replace(FAILED, name=CheckName.POSE), FIXED))
LISTED = View(STOPPED, teams=TeamList({3: "Delft", 12: "Graz"}))
CANNOT = "the check 'clock skew' cannot be waived: another clock"
UNDECIDED = Flag(FlagKind.DOUBT, "doubted: all", FlagWeight.ALARM, undecided=True)


@pytest.mark.parametrize(
    ("act", "view", "keys", "found"),
    [
        (Correct, View(STOPPED), "t 1", Correct(3, CW, "typed wrongly")),
        (Correct, View(STOPPED), "o o slip", Correct(3, TO_OPEN, "slip")),
        (Correct, View(STOPPED), "4 o slip", Correct(3, WIND, "slip")),
        (Correct, View(STOPPED), "s 12 Graz o slip", Correct(12, SETUP.condition, "slip", "Graz")),
        (Correct, View(STOPPED), "s 12a", "subject '12a': use a number from 1 to 999"),
        (Correct, View(STOPPED), "s 1234", "subject '1234': use a number from 1 to 999"),
        (Correct, LISTED, "s 12 o slip", Correct(12, SETUP.condition, "slip")),
        (Correct, View(Run()), "", "no run is set up yet"),
        (TakeBack, View(STOPPED), "", "there is nothing to take back"),
        (TakeBack, View(RUNS[Phase.STOPPED]), "o ?", TakeBack(DecisionKind.INCIDENT, 110.0, "?")),
        (FileProtest, View(STOPPED), "w o Graz slow", FileProtest("slow", "Graz")),
        (FileProtest, View(STOPPED), "w 1 slow", FileProtest("slow", "Delft")),
        (
            FileProtest,
            View(STOPPED, steps=CROSSED),
            "4 1 slow",
            FileProtest("slow", "Delft", "step 4: cross the threshold", 7.0),
        ),
        (
            FileProtest,
            View(STOPPED),
            "t 1:05 1 x",
            FileProtest("x", "Delft", "65.000 s", 65.0),
        ),
        (FileProtest, View(STOPPED), "t soon", "'soon' is no time: 12.5, -3 or 1:05 is one"),
        (
            FileProtest,
            View(STOPPED),
            "t 76",
            "the recording goes from -5 s to 15 s: 76 s is more than 60 s outside it",
        ),
        (
            FileProtest,
            View(STOPPED),
            "t -66",
            "the recording goes from -5 s to 15 s: -66 s is more than 60 s outside it",
        ),
        (FileProtest, View(STOPPED), "t -65 1 x", FileProtest("x", "Delft", "-65.000 s", -65.0)),
        (FileProtest, View(STOPPED), "i a 1 x", FileProtest("x", "Delft", "execution time")),
        (
            FileProtest,
            View(STOPPED, indicators=DOUBTED),
            "i b 1 x",
            FileProtest("x", "Delft", "passage time"),
        ),
        (FileProtest, View(PROTESTED), "a w 1 x", FileProtest("x", "Delft")),
        (FileProtest, View(PROTESTED), "w 1", WithdrawProtest(1, "satisfied by the explanation")),
        (FileProtest, View(PROTESTED), "d r no", DecideProtest(1, ProtestEnd.REJECTED, "no", ADA)),
        (DecideProtest, View(TWO), "b p yes", DecideProtest(2, ProtestEnd.PARTLY, "yes", ADA)),
        (DecideProtest, View(NAMELESS), "u x Eve", DecideProtest(1, ProtestEnd.UPHELD, "x", "Eve")),
        (WithdrawProtest, View(STOPPED), "", "no protest is open"),
        (AcceptDoubts, View(STOPPED), "", "no doubt waits for the referee"),
        (AcceptDoubts, View(STOPPED, indicators=DOUBTED), "a 2", "every"),
        (
            AcceptDoubts,
            View(STOPPED, indicators=DOUBTED),
            "2 o ?",
            AcceptDoubts({PASSAGE: ONE_SAMPLE[TIME]}, "?"),
        ),
        (
            AcceptDoubts,
            View(STOPPED, indicators={TIME: DOUBTED[TIME]}),
            "1",
            AcceptDoubts(ONE_SAMPLE, "seen on video: right"),
        ),
        (Finalise, View(STOPPED), "a fine", Finalise(TeamWord.ACKNOWLEDGED, ADA, "fine")),
        (
            Finalise,
            View(STOPPED, flags=(UNDECIDED,)),
            "y b fine",
            Finalise(TeamWord.ABSENT, ADA, "fine", ("doubted: all",)),
        ),
        (Finalise, View(NAMELESS), "a fine Eve", Finalise(TeamWord.ACKNOWLEDGED, "Eve", "fine")),
        (Waive, View(READY), "", "no check fails"),
        (Waive, View(READY, (FIXED,)), "", CANNOT),
        (Waive, View(READY, (FAILED,)), "space", Waive(CheckName.DOOR, NO_REASON)),
        (Waive, View(READY, (FAILED,)), "1", Waive(CheckName.DOOR, "checked by hand")),
        (Waive, OPEN_DOOR, "2 o ?", Waive(CheckName.POSE, "?")),
        (MarkIncident, View(RUNNING, elapsed=3.0), "f", MarkIncident(IncidentKind.FALL)),
        (
            MarkIncident,
            View(RUNNING, elapsed=3.0),
            "o bang",
            MarkIncident(IncidentKind.OTHER, "bang", 3.0),
        ),
        (MarkIncident, View(STOPPED), "c 1:05", MarkIncident(IncidentKind.COLLISION, "", 65.0)),
        (MarkIncident, View(STOPPED), "o a 2", MarkIncident(IncidentKind.OTHER, "a", 2.0)),
        (MarkIncident, View(STOPPED), "h x", "'x' is no time: 12.5, -3 or 1:05 is one"),
        (MarkIncident, View(RUNNING), "w slow", AddNote("slow")),
        (Rule, View(STOPPED), "c", Rule(Step.CROSS, confirmed=True, reason=NO_REASON)),
        (Rule, View(STOPPED), "d", Rule(Step.CROSS, confirmed=False, reason=NO_REASON)),
        (Rule, View(STOPPED, steps=CROSSED), "s", Rule(Step.CROSS, None, NO_REASON)),
        (Rule, View(STOPPED), "r o arm d", Rule(Step.CROSS, confirmed=False, reason="arm")),
        (Abort, View(RUNNING), "1", Abort("robot unsafe")),
        (Reissue, View(DONE), "o appeal", Reissue("appeal")),
        (RestartCountdown, View(RUNS[Phase.COUNTDOWN]), "", RestartCountdown()),
        (RestartCountdown, View(COUNTDOWN), "1", RestartCountdown("robot not ready")),
    ],
)
def test_the_keys_of_a_dialog_make_the_act(
    act: type[Act], view: View, keys: str, found: object
) -> None:
    every = AcceptDoubts(
        dict.fromkeys((TIME, PASSAGE), ONE_SAMPLE[TIME]), "no effect on the ranking"
    )
    expected = every if found == "every" else found
    assert answered(asked(act, view), *keys.split()) == expected


def asked(act: type[Act], view: View) -> object:
    """What its key asks, or what another question asks before it; 4 is pressed."""
    snapshot = cast("Snapshot", view)
    if act is DecideProtest:
        return ask_decision(snapshot, "4")
    if act is WithdrawProtest:
        return ask_withdrawal(snapshot, "4")
    return next(key for key in KEYS.values() if key.act == act.name).intent(snapshot, "4")


def answered(intent: object, *keys: str) -> object:
    """What comes of a dialog: for each question the key of an option, or a text."""
    rest = iter(keys)
    while isinstance(intent, Ask):
        answers = []
        for question in intent.questions:
            match question:
                case Pick(options=options):
                    key = next(rest).replace("space", " ")
                    (option,) = (one for one in options if one.key == key)
                    answers.append(next(rest) if option.free else option.value)
                case Write():
                    answers.append(next(rest))
        intent = intent.make(*answers)
    assert list(rest) == []
    return intent


def shown(intent: object) -> str:
    """All that the next dialog says, a line for each title, question and listed line."""
    assert isinstance(intent, Ask)
    lines = [intent.title]
    for question in intent.questions:
        options = question.options if isinstance(question, Pick) else ()
        lines += [*(question.listed if isinstance(question, Pick) else ()), question.text]
        lines += [f"{option.key} {option.label}" for option in options]
    return "\n".join(lines)


ANSWER = ProtestAnswer(210.0, ProtestEnd.UPHELD, "video", ADA)
OUTDATED = replace(PROTEST, answer=ANSWER)
UPHELD = replace(STOPPED, protests=(OUTDATED,))
MANY_DOUBTS = {TIME: replace(DOUBTED[TIME], doubts=tuple(f"doubt {n}" for n in range(6)))}
HINT = "! protest 1 (step 4) was upheld: nothing was changed since"
REJECTED = replace(OUTDATED, answer=replace(ANSWER, end=ProtestEnd.REJECTED))


@pytest.mark.parametrize(
    ("question", "words", "said"),
    [
        (lambda: asked(Finalise, View(UPHELD)), HINT, True),
        (
            lambda: asked(Finalise, View(replace(UPHELD, protests=(REJECTED,)))),
            HINT,
            False,
        ),
        (lambda: asked(Finalise, View(replace(UPHELD, changed=131.0))), HINT, False),
        (
            lambda: asked(Finalise, View(STOPPED, flags=(UNDECIDED,))),
            "! doubted: all",
            True,
        ),
        (lambda: asked(FileProtest, View(PROTESTED)), "it was slower", True),
        (lambda: asked(FileProtest, View(TWO)), "2 protests are open", True),
        (lambda: asked(DecideProtest, View(PROTESTED)), "! Graz: it was slower", True),
        (
            lambda: asked(WithdrawProtest, View(PROTESTED)),
            "! Graz: it was slower",
            True,
        ),
        (
            lambda: asked(TakeBack, View(RUNS[Phase.STOPPED])),
            "Take back the last decision: incident at 5.000 s: fall",
            True,
        ),
        (
            lambda: asked(AcceptDoubts, View(STOPPED, indicators=DOUBTED)),
            "a on all of them\n1 time to handle: 1 doubt\n2 passage time: 1 doubt",
            True,
        ),
        (
            lambda: asked(AcceptDoubts, View(STOPPED, indicators={TIME: DOUBTED[TIME]})),
            "? the touch rests on 1 sample\nWhy?",
            True,
        ),
        (
            lambda: asked(AcceptDoubts, View(STOPPED, indicators=MANY_DOUBTS)),
            "? doubt 3\n? and 2 more: the result has all of them\nWhy?",
            True,
        ),
        (
            lambda: asked(Finalise, View(STOPPED, steps=CROSSED, flags=(UNDECIDED,))),
            "completed, steps 4\n! doubted: all",
            True,
        ),
        (
            lambda: asked(Finalise, View(STOPPED, flags=(UNDECIDED,))),
            "completed, steps none\n",
            True,
        ),
        (
            lambda: asked(FileProtest, View(STOPPED, steps=CROSSED)),
            (
                "What is it about?\nw the whole run\n4 cross the threshold\n"
                "i an indicator\nt a time of the run: type it"
            ),
            True,
        ),
        (
            lambda: asked(FileProtest, View(PROTESTED)),
            "What becomes of it?\nd decide it\nw the team withdraws it\na another protest is filed",
            True,
        ),
        (
            lambda: asked(WithdrawProtest, View(PROTESTED)),
            "What does the team say?\nn no\n  no reason given\n1 satisfied by the explanation\n2 ",
            True,
        ),
        (
            lambda: asked(Rule, View(STOPPED)),
            "\nc confirm\nd deny\ns as the sensors say\nr give a reason",
            True,
        ),
        (lambda: ask_void_instead("unsafe"), "was over before the abort (unsafe)", True),
        (
            lambda: asked(Rule, View(STOPPED)),
            "Sensors: not done. Referee: nothing yet.",
            True,
        ),
        (
            lambda: asked(Rule, View(STOPPED, steps=CROSSED)),
            "Step 4: cross the threshold (no reason given)\nSensors: 6.000 s. Referee: nothing",
            True,
        ),
    ],
)
def test_a_dialog_shows_what_the_answer_hangs_on(
    question: Callable[[], object], words: str, said: bool
) -> None:
    assert (words in shown(question())) is said


def test_two_answers_to_a_question_never_have_the_same_key() -> None:
    fall, fire = Option("f", "fall", "fall"), Option("f", "fire", "fire")
    with pytest.raises(ValueError, match="'Which\\?': two options have the same key"):
        Pick("Which?", (fall, fire))


def test_a_reason_that_nobody_chose_claims_nothing() -> None:
    why = ask_why("seen on video: right")
    assert why.options[why.marked].value is None
    assert why.options[1].value == NO_REASON == "no reason given"


@pytest.mark.parametrize(
    ("rule", "shown"),
    [
        ("zero the handle again: it was off", "F7 zeroes the handle again: it was off"),
        ("confirm the start pose", "F6 confirms the start pose"),
        (
            "correct the team, or waive the check: 9 is not in the list",
            "F2 corrects the team, Enter waives: 9 is not in the list",
        ),
        (
            "a protest is open: decide it first",
            "a protest is open: decide it first (Enter, then P)",
        ),
        ("20 protests already: add a note", "20 protests already: add a note (n)"),
        ("close the door: angle +0.500 rad", "close the door: angle +0.500 rad"),
    ],
)
def test_the_screens_add_the_key_to_what_a_rule_says_is_to_be_done(rule: str, shown: str) -> None:
    assert with_caps(rule) == with_caps(with_caps(rule)) == shown
