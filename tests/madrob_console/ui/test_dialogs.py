from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest
from textual.widgets import Input

from madrob_console.common.names import SourceKind
from madrob_console.engine.snapshot import Pulse, RightToAct
from madrob_console.referee.acts import (
    Abort,
    AddNote,
    Correct,
    DeclareTimeout,
    Finalise,
    MarkIncident,
    RestartCountdown,
    Rule,
    TakeBack,
    Void,
)
from madrob_console.referee.records import IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from madrob_console.referee.team_list import TeamList
from madrob_console.ui.keys.questions import NO_REASON
from madrob_console.ui.panes.run_status import clock_span
from scoring.protocol import Outcome, Side, Step
from scoring.stamps import REORDERED
from tests.madrob_console.ui.driver import (
    Driver,
    Stories,
    Story,
    did_nothing,
    engine_does,
    follow,
    has,
    in_sizes,
    no,
    no_question,
    pane,
    passes,
    play,
    remember,
    says,
    says_only,
    sets,
    setup_of,
    types_every,
)
from tests.madrob_console.ui.inline_engine import HandEngine
from tests.madrob_console.ui.prepared import a_setup

SLIPS = [
    "f8 f8",
    "f8 f8 f8 enter",
    "f8 enter",
    "f8 enter enter",
    "f8 n",
    "f8 escape",
    "f8 1 enter",
    "f8 1 f8 enter enter",
    "f8 1 escape",
    "f8 1 n",
    "f8 down enter enter",
    "f8 o x enter enter",
    "f8 o enter enter escape",
    "f8 space tab enter",
    "escape escape",
    "f9 f9 enter f9 1 enter",
    "f9 f8 escape escape",
    "f10 enter",
    "f10 n",
    "ctrl+c escape",
    "ctrl+q enter",
    "f5 f5",
]


@pytest.mark.slow
async def test_no_slip_ends_a_run(driver: Driver, engine: HandEngine) -> None:
    await driver.run()
    acts = list(engine.acts)
    for keys in SLIPS:
        await driver.press(*keys.split())
        assert engine.run.phase is Phase.RUNNING, keys
        assert engine.acts == acts, keys
        assert driver.app.is_running, keys
        await escape(driver)


async def escape(driver: Driver) -> None:
    """Close all questions."""
    await driver.press(*["escape"] * len(driver.console.dialogs))


SIGNED_SO = "1 false start UNDECIDED (handle touched)"


WITH_A_FALSE_START: Story = [
    (Driver.set_up,),
    ("f5",),
    (passes(5.0),),
    (engine_does(HandEngine.touch, 0.02),),
    (passes(1.0),),
    ("i f",),
    (Driver.finish,),
]
"""A run is over; nobody has decided about its false start."""

MACHINE, QUICK, SLOW = 0.0, 0.15, 1.0
"""Between two keys: a script, a quick hand, a slow one, s."""


STAGES: Sequence[Story] = [
    [("f2 enter f3",)],
    [("f6 f5",), (engine_does(HandEngine.touch),)],
    [(engine_does(HandEngine.act, RestartCountdown()),), (passes(6.0),), ("i c",)],
    [(Driver.finish,)],
]


@pytest.mark.parametrize(
    "opens",
    ["f8", "f9", "i", "1", "enter", "enter n", "enter f", "enter u", "enter c", "enter P"],
)
async def test_enter_alone_does_nothing_that_cannot_be_taken_back(
    driver: Driver, engine: HandEngine, opens: str
) -> None:
    for stage in STAGES:
        await follow(driver, stage)
        before = engine.run
        await driver.press(*opens.split())
        if driver.console.dialogs:
            await driver.press("enter")
            assert engine.run == before
            assert driver.app.is_running
            await escape(driver)
        assert engine.run == before


OTHER = IncidentKind.OTHER
LEFT_OUT = says("is left out: the result has just come")


def clock_reads(text: str) -> Callable[[Driver], object]:
    return lambda driver: (
        clock_span(driver.engine.snapshot()).text == text
        and all({"┃", "┏", "┗"} & {*row} for row in driver.rows()[2:5])
    )


def asks(title: str) -> Callable[[Driver], object]:
    return lambda driver: [title in one.ask.title for one in driver.console.dialogs] == [True]


def is_void(void: bool) -> Callable[[Driver], object]:
    return lambda driver: (driver.engine.run.voided is not None) is void


def incident_at(after_start: float) -> Callable[[Driver], object]:
    return lambda driver: (
        (start := driver.engine.run.start) is not None
        and driver.engine.run.incidents[-1].time == start + after_start
    )


def field_holds(text: str) -> Callable[[Driver], object]:
    return lambda driver: [d.query_one(Input).value for d in driver.console.dialogs] == [text]


def no_answer(driver: Driver) -> object:
    return [dialog.answers for dialog in driver.console.dialogs] == [[]]


STORIES: Stories = {
    "the clock stays in view and runs on under a dialog": [
        (Driver.run, clock_reads("0:01.0")),
        ("f8", clock_reads("0:01.0")),
        (passes(2.0), clock_reads("0:03.0"), "4:57 left"),
    ],
    **{
        f"an abort that came too late offers to void the run: {answer}": [
            (Driver.run,),
            ("f8 1",),
            (lambda d: d.engine.finish(),),
            ("y", asks("The run was over before the abort (robot unsafe)")),
            ("", "run 1 of subject 1 Door Bots", Outcome.COMPLETED),
            (answer, no_question, is_void(void)),
        ]
        for answer, void in (("y", True), ("enter", False))
    },
    "who confirms an abort that came too late is asked about voiding the run": [
        (Driver.run,),
        ("f8 1",),
        (Driver.finish,),
        (remember,),
        (types_every(QUICK),),
        (lambda d: setattr(d.hand, "now", d.hand.now + SLOW),),
        # the second y was typed before the question could be seen
        ("y y", "The run was over before the abort (robot unsafe)", did_nothing),
        (types_every(SLOW),),
        ("y", Void("robot unsafe")),
    ],
    "leaving asks while a run goes on": [
        (Driver.run,),
        ("f10", "LEAVE the console while a run goes on"),
        # who opened the client closes it
        ("y", lambda d: not d.app.is_running, lambda d: not d.engine.closed),
    ],
    "leaving asks nothing after a run": [
        (Driver.run,),
        (Driver.finish,),
        ("f10", lambda d: not d.app.is_running),
    ],
    "another incident is said in words and stands where its kind was chosen": [
        (Driver.run,),
        (passes(2.0),),
        ("i o", "What happened?"),
        (passes(3.0),),
        ("enter", "say what happened"),
        ("'=dog on the field' enter", MarkIncident(OTHER, "dog on the field", 3.0)),
        ("", says("Done: incident marked: other at +"), says("dog on the field")),
        (Driver.finish,),
        ("i o =lamp enter =1:05 enter", MarkIncident(OTHER, "lamp", 65.0)),
    ],
    "an incident is one of now while the run goes on and asks for its time after it": [
        (Driver.run,),
        ("i c", MarkIncident(IncidentKind.COLLISION), incident_at(1.0)),
        (passes(20.0),),
        (Driver.finish,),
        (remember,),
        ("i f", "When? Seconds from the start of the run"),
        ("enter", "its time is needed: the run has stopped"),
        ("=later enter", "'later' is no time", did_nothing),
        (
            "backspace*5 =0:12.5 enter",
            MarkIncident(IncidentKind.FALL, after_start=12.5),
            incident_at(12.5),
        ),
        ("i f =-60 enter", says("the recording began at -5.0 s")),
    ],
    **{
        f"a refused start leaves the field so that no key is typed into it: {gap}": [
            ("enter",),
            (lambda d: d.console.set_focus(d.console.query_one("#team")),),
            (types_every(gap),),
            ("f5", says("Refused: start")),
            ("n =robot enter f9 2 y", "Team (/ list) Door Bots"),
            ("", lambda d: not any(isinstance(act, DeclareTimeout) for act in d.engine.acts)),
        ]
        for gap in (MACHINE, SLOW)
    },
    **{
        f"a key typed as the result comes is left out unless it could be seen: {gap}, {key}": [
            (Driver.run,),
            (remember,),
            (Driver.finish,),
            (types_every(gap),),
            (key, did_nothing, *([LEFT_OUT, no_question] if gap < 0.3 else [])),
        ]
        for gap, key in (
            *((MACHINE, key) for key in ("3", "y", "i", "enter")),
            *((QUICK, "3"), (SLOW, "enter")),
        )
    },
    **{
        f"a text typed into a choice is no answer and no other text: {gap}, {text}": [
            (Driver.run,),
            (Driver.finish,),
            (remember,),
            (opens,),
            (types_every(gap),),
            (f"'={text}'", did_nothing, field_holds("")),
            ("", *([] if text.startswith("a") else [no_answer])),  # "a" is an answer
        ]
        for gap, opens, text in (
            (MACHINE, "enter f", "Team satisfied"),
            (QUICK, "4", "the robot did not cross"),
            (MACHINE, "enter f", "absent bots"),
            (QUICK, "enter", "bots satisfied"),
        )
    },
    "abort is confirmed by y after a reason": [
        (Driver.run,),
        ("f8", "ABORT the run", "> n no, the run goes on"),
        ("1", "chosen: robot unsafe"),
        ("y", Outcome.ABORTED, lambda d: d.engine.run.outcome_reason == "robot unsafe"),
    ],
    "the reason can be typed": [
        (Driver.run,),
        ("f8 o enter", "a reason is needed"),
        ("'=smoke, [b]much[' enter y", Abort("smoke, [b]much[")),
    ],
    "abort comes before a note that is being typed": [
        (Driver.run,),
        ("i w a f8 1 y", Outcome.ABORTED),
        ("b enter", AddNote("ab")),
    ],
    "other keys wait for the open question": [
        (Driver.run,),
        (
            "i f9 f2",
            "A question is open: answer it, or Escape closes it.",
            pane("live"),
            lambda d: len(d.console.dialogs) == 1,
        ),
    ],
    "a void and a correction are made and taken back by keys": [
        (Driver.run,),
        (Driver.finish,),
        (
            "enter v 2 y",
            lambda d: (void := d.engine.run.voided) and void.reason == "testbed fault",
            says("z takes it back"),
        ),
        ("enter", "Not now: v void: the run is void already"),
        ("c t 1", lambda d: setup_of(d).condition.starting_side is Side.CW),
        ("enter c s =12x enter", "subject '12x': use a number"),
        (
            "escape z 1 z 1",
            lambda d: d.engine.run.valid,
            lambda d: d.engine.run.setup == d.engine.run.set_up_as,
            lambda d: len(d.engine.run.taken_back) == 2,
        ),
        ("z", says("Refused: take back: there is nothing to take back")),
    ],
    "among many runs the letter of void is theirs": [
        (Driver.run,),
        (Driver.finish,),
        ("h v", no_question, lambda d: "Refused" not in d.console.status),
    ],
    "a ruling shows what the sensors and the referee say": [
        (Driver.run,),
        (lambda d: d.engine.do_step(Step.TOUCH),),
        (lambda d: d.engine.tick(REORDERED),),
        ("1", "Sensors: 1.000 s. Referee: nothing yet."),
        (
            "r o '=only brushed' enter down down enter",
            Rule(Step.TOUCH, confirmed=False, reason="only brushed"),
        ),
    ],
    "the next run says that the result before is not final": [
        (Driver.run,),
        (Driver.finish,),
        ("x", says("the result before is not final: h opens it"), Phase.READY, pane("setup")),
    ],
    "after an abort the next run is one key away": [
        (Driver.run,),
        ("f8 1 y",),
        (lambda d: d.engine.score(),),
        (Driver.settle,),
        (
            "x",
            Phase.READY,
            lambda d: setup_of(d).run_number == 2,
        ),
    ],
    "finalising asks for the name where none was set": [
        ("tab*7 enter shift+tab backspace",),
        (Driver.run,),
        (Driver.finish,),
        ("enter f a enter enter", "signing needs the referee's name"),
        (
            "=Bo enter",
            lambda d: (closure := d.engine.run.closure) and closure.referee == "Bo",
            "signed by Bo, acknowledged by the team",
        ),
    ],
    "what is undecided is seen before a result is final": [
        *WITH_A_FALSE_START,
        (
            "enter f",
            "completed, steps 1, 2, 3, 4, 5, 6;",
            f"! {SIGNED_SO}",
            "1 incident (fall)",
            "> n no: decide first",
        ),
        (remember,),
        ("a p b enter", did_nothing, no_question),
        ("enter f y a enter", Finalise(TeamWord.ACKNOWLEDGED, "Ada", "", (SIGNED_SO,))),
    ],
    "with nothing undecided the list stands above the teams word": [
        (in_sizes((60, 18), (120, 36)),),
        *WITH_A_FALSE_START,
        (
            "enter a 1 5 d enter f",
            "completed, steps",
            "- step 5 denied; 1 false start accepted; SIMULATED: not an official result;",
            "1 incident (fall)",
            "What does the team say?",
            "> n nothing yet: do not sign",
            "b absent",
        ),
        ("a enter", Finalise(TeamWord.ACKNOWLEDGED, "Ada")),
    ],
    "with nothing to be seen signing asks no more than the team": [
        (sets(kind=SourceKind.ROS),),
        (Driver.run,),
        (Driver.finish,),
        ("enter f", "completed, steps 1, 2, 3, 4, 5, 6;", "What does the team say?"),
    ],
    "another subject is shown with its team before it is corrected": [
        (Driver.run,),
        (Driver.finish,),
        (has(teams=TeamList({1: "Delft", 4: "Graz"})),),
        ("enter c s 4 enter", "Correct the subject from 1 to 4, Graz"),
        ("1", Correct(4, a_setup().condition, "typed wrongly")),
    ],
    "a text of a question that was closed does not come back": [
        (Driver.run,),
        (Driver.finish,),
        (
            "enter c s 9 9 enter escape enter c s",
            field_holds(""),
        ),
        (
            "3 enter*2 space",
            lambda d: isinstance(act := d.engine.acts[-1], Correct) and act.subject == 3,
        ),
    ],
    "a key right after Escape goes to the pane": [
        (Driver.run,),
        ("f1", pane("help")),
        ("escape h", pane("history")),
        ("escape f3", pane("live")),
        ("enter escape 4", "Step 4: cross the threshold", no("left out")),
        ("d", Rule(Step.CROSS, confirmed=False, reason=NO_REASON)),
        ("i escape h", pane("history")),
    ],
    "n is no in every question": [
        (Driver.run,),
        (Driver.finish,),
        ("enter v n", lambda d: d.engine.run.voided is None, no_question),
        ("enter v enter", lambda d: d.engine.run.voided is None, no_question),
        ("enter c n", no_question),
        ("1 n", no_question),
    ],
    "a wrong team that is seen in a run is corrected after it": [
        (Driver.run,),
        ("enter", "Not now: c correct: let the run end, then correct it"),
    ],
    "the menu takes the keys that its first line names": [
        (Driver.run,),
        ("enter", "1-6 confirm or deny a step; i mark an incident", no("z take back")),
        (
            "4 d enter i c enter z space",
            lambda d: [type(act) for act in d.engine.acts[-3:]] == [Rule, MarkIncident, TakeBack],
            lambda d: d.engine.run.incidents == (),
        ),
    ],
    "a question leaves the footer the keys that work": [
        (Driver.run,),
        ("i", lambda d: d.rows()[-1] == "a question is open  F8 ABORT  F10 Leave"),
        ("escape", lambda d: d.rows()[-1].startswith("F8 ABORT  F9 Timeout")),
    ],
    **{
        f"what answers an abort is nothing else once the run is over: {gap}, {keys}": [
            (Driver.run,),
            (remember,),
            ("f8",),
            (Driver.finish, "NOT POSSIBLE ANY MORE: the run has stopped"),
            (types_every(gap),),
            (keys, did_nothing, Outcome.COMPLETED),
        ]
        for gap, keys in (
            *((MACHINE, keys) for keys in ("1 y", "2 2 y", "o x enter y")),
            *((QUICK, "1 y"), (SLOW, "2 2 y")),
        )
    },
    "the dialog over a run that has completed closes with enter": [
        (Driver.run,),
        ("f8",),
        (Driver.finish,),
        ("enter", no_question),
        (Driver.settle, pane("results")),
    ],
    **{
        f"a refused key never lets the next letters mean something else: {gap}": [
            (Driver.run,),
            (Driver.finish,),
            (remember,),
            ("escape",),
            (types_every(gap),),
            ("f9", says("Refused: declare timeout: the run has stopped")),
            ("2", says("F9 was refused: the run has stopped")),
            ("enter f9 2 y", did_nothing, no_question),
        ]
        for gap in [MACHINE, SLOW]
    },
    "after a refusal and a pause letters are keys again": [
        (Driver.run,),
        (Driver.finish,),
        ("f9 2", "Step 2"),
        ("escape",),
        (types_every(QUICK),),
        ("f9 escape 2", "Step 2"),
    ],
    "the key that aborts counts whatever has just changed": [
        (Driver.set_up,),
        ("f5",),
        (types_every(MACHINE),),
        (passes(6.0),),
        ("f8 1 y", Abort("robot unsafe")),
    ],
    **{
        f"the rest of a word that answered is no key: {gap}": [
            (Driver.run,),
            ("f9 1",),
            (types_every(gap),),
            ("=yes", DeclareTimeout("the team gives up"), pane("live"), no_question),
        ]
        for gap in [MACHINE, QUICK]
    },
    "a ruling is two keys also when the sensors find the step meanwhile": [
        (Driver.run,),
        ("1", "passage sensors", "Sensors: not done"),
        (lambda d: d.engine.do_step(Step.TOUCH),),
        (lambda d: d.engine.tick(REORDERED),),
        (types_every(MACHINE),),
        (Driver.settle, "Sensors: 1.000 s"),
        ("d", Rule(Step.TOUCH, confirmed=False, reason=NO_REASON)),
    ],
    "a text that is being typed survives a moment in which it is not possible": [
        (Driver.run,),
        ("i w c a b l e",),
        (
            has(right=RightToAct(holder="bo@tent")),
            "NOT POSSIBLE ANY MORE: bo@tent has the right to act",
        ),
        ("x y",),
        (has(right=RightToAct()),),
        ("s enter", AddNote("cables")),
    ],
    "a note goes on while the run ends": [
        (Driver.run,),
        ("i w a",),
        (types_every(QUICK),),
        ("b",),
        (Driver.finish,),
        ("c enter", AddNote("abc")),
    ],
    "a console whose engine has ended refuses with that and leaves without a question": [
        (Driver.run,),
        ("f8",),
        (has(failure="the engine has ended"), "NOT POSSIBLE ANY MORE: the engine has ended"),
        ("enter i", says_only("Refused: mark an incident: the engine has ended"), Phase.RUNNING),
        ("f10", lambda d: not d.app.is_running),
    ],
    "leaving a silent engine says that nobody knows": [
        (Driver.run,),
        (sets(pulse=Pulse(server=4)),),
        ("f10", "Nobody can say whether the run goes on"),
        ("enter", lambda d: d.app.is_running),
    ],
    "a field is typed into only where that was chosen": [
        (Driver.run,),
        (Driver.finish,),
        ("x", pane("setup"), lambda d: not isinstance(d.app.focused, Input)),
        ("f2", lambda d: isinstance(d.app.focused, Input)),
        ("f3 enter n =ok enter", AddNote("ok"), lambda d: not isinstance(d.app.focused, Input)),
        ("f2 escape enter", lambda d: d.console.query_one("#subject", Input).value == "1"),
    ],
}


@pytest.mark.parametrize("story", STORIES)
async def test_what_keys_do_and_what_is_seen_then(story: str) -> None:
    await play(HandEngine, STORIES[story])
