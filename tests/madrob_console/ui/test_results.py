"""A result on the screens: its values, doubts and protests; and the runs before it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from rich.cells import cell_len
from textual.widgets import Input

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.engine.requests import ExportDossier
from madrob_console.engine.snapshot import Pulse
from madrob_console.pages.tally import Aggregate
from madrob_console.referee.acts import (
    AcceptDoubts,
    DecideProtest,
    FileProtest,
    Rule,
    WithdrawProtest,
)
from madrob_console.referee.flags import FlagWeight
from madrob_console.referee.protests import ProtestEnd
from madrob_console.referee.records import Voiding
from madrob_console.referee.run_summary import RunSummary
from madrob_console.referee.team_list import TeamList
from madrob_console.ui.cells.lines import Tone, plain
from madrob_console.ui.look.words import export_text
from madrob_console.ui.panes.history_pane import HistoryPane, about, columns
from madrob_console.ui.panes.history_pane import summary as head_line
from madrob_console.ui.panes.result_details import IndicatorTable, ResultDetails, compared
from madrob_console.ui.panes.result_pane import ResultHead, ResultsPane
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome, Step
from scoring.result import Indicator, Uncertainty
from tests.madrob_console.run_folders import EPOCH, UNDECIDED_START, VALUES, summary
from tests.madrob_console.ui.driver import (
    LARGE,
    PANE,
    SMALL,
    Alone,
    Driver,
    Item,
    Stories,
    Story,
    acting,
    answered,
    engine_does,
    follow,
    has,
    in_sizes,
    no,
    on_engine,
    opened,
    pages,
    passes,
    play,
    play_alone,
    says,
    sets,
    showing,
)
from tests.madrob_console.ui.inline_engine import FOLDER, HandEngine, at_rest, measured_as
from tests.madrob_console.ui.prepared import indicators

TIME = IndicatorName.EXECUTION_TIME
HANDLE = IndicatorName.TIME_TO_HANDLE
PASSAGE = IndicatorName.PASSAGE_TIME


async def is_interrupted(driver: Driver) -> None:
    """The run is shown as one that was cut off."""
    state, outcome = driver.engine.snapshot(), Outcome.INTERRUPTED
    assert state.result is not None
    run, result = replace(state.run, outcome=outcome), replace(state.result, outcome=outcome)
    driver.engine.put(run=run, result=result)
    await driver.settle()


def shows(found: dict[IndicatorName, Indicator]) -> Callable[[Driver], object]:
    """The result has these indicators."""

    async def change(driver: Driver) -> None:
        result = driver.engine.snapshot().result
        assert result is not None
        driver.engine.put(result=replace(result, indicators=found))
        await driver.settle()

    return change


def without(reason: str) -> dict[IndicatorName, Indicator]:
    return {name: Indicator.missing(name, reason) for name in IndicatorName}


def nothing_cut(driver: Driver) -> object:
    return "…" not in "".join(driver.rows()[1:])


def copied(words: str) -> Callable[[Driver], object]:
    return lambda driver: words in driver.console.panes.results.copied


# Completed by the sensors, with nearly everything that a referee should know at once.

DENIED = Rule(Step.CROSS, False, "a wheel stayed on the line all the time")
WITH_FLAGS: Story = [
    (Driver.set_up,),
    ("f5",),
    (passes(5.0),),
    (engine_does(HandEngine.touch, 0.02),),
    (passes(1.0),),
    ("i f",),
    (Driver.finish,),
    (engine_does(HandEngine.act, DENIED),),
    (Driver.settle,),
]
ENDED = "ENDED, valid (3 of 6 steps count: the referee denied step 4)"


def toned(words: str, tone: Tone | None, **run: Any) -> Callable[[Driver], object]:  # noqa: ANN401
    """The tone of words in the head of the result, if the run has these; None, none is there."""

    def is_so(driver: Driver) -> bool:
        state = driver.engine.snapshot()
        lines = ResultHead().draw_lines(replace(state, run=replace(state.run, **run)), 78)
        return {span.text: span.tone for row in lines for span in row}.get(words) is tone

    return is_so


def steps_apart(driver: Driver) -> object:
    """All steps are there, beside the result or below it."""
    found = [
        row.partition(f"✓ {step} {step.text}")[0]
        for row in driver.rows()
        for step in Step
        if f"✓ {step} {step.text}" in row
    ]
    beside = [bool(left.strip()) for left in found]
    wide = driver.app.size.width >= 120
    ends = all(left.endswith("  ") or not left.strip() for left in found)
    return beside == [wide] * len(Step) and ends


async def test_values_and_steps_of_an_ordinary_result_fill_20_rows_and_v_has_its_details(
    driver: Driver, engine: HandEngine
) -> None:
    engine.put(kind=SourceKind.ROS)
    await follow(driver, WITH_FLAGS)
    pane = ResultsPane(lambda: ())
    first: Sequence[Item] = (
        *(name.words for name in IndicatorName),
        *(f"{step} {step.text}" for step in Step),
        no("comparison"),
    )
    rows: Story = [
        (lambda _: pane.show(engine.snapshot()),),
        (Alone.settle, *first),
        ("v", "comparison", "ruleset", "files", no("COMPLETED")),
        ("v", *first),
    ]
    await play_alone(pane, *rows, size=(80, 20))


EXACT = Aggregate.of([10.0, 10.0])
KNOWN_TO_0_1 = Aggregate.of([10.0], [Uncertainty(0.05, 0.1)])


@pytest.mark.parametrize(
    ("name", "earlier", "value", "expanded", "words", "tone"),
    [
        (TIME, EXACT, 9.0, None, "-1.0000 better", Tone.GOOD),
        (TIME, EXACT, 12.0, None, "+2.0000 worse", Tone.WARN),
        (IndicatorName.CAPABILITY_LEVEL, EXACT, 12, None, "+2.0000 better", Tone.GOOD),
        (IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION, EXACT, 9.0, None, "-1.0000 worse", Tone.WARN),
        (PASSAGE, EXACT, 10.0, None, "+0.0000 equal", Tone.PLAIN),
        # within the uncertainties it is neither
        (TIME, KNOWN_TO_0_1, 10.2, 0.1, "+0.2 within +-", Tone.PLAIN),
        (TIME, KNOWN_TO_0_1, 10.5, 0.1, "+0.5 worse", Tone.WARN),
        (TIME, KNOWN_TO_0_1, 9.5, 0.1, "-0.5 better", Tone.GOOD),
        (TIME, KNOWN_TO_0_1, 10.0, 0.1, "+0.0 within +-", Tone.PLAIN),
        (TIME, KNOWN_TO_0_1, 10.0, None, "+0.0000 equal", Tone.PLAIN),
        (TIME, KNOWN_TO_0_1, 10.2, None, "+0.2000 worse", Tone.WARN),
        (TIME, KNOWN_TO_0_1, 60.0, 0.0, "+50.0 worse", Tone.WARN),  # exact, but the mean is not
        (TIME, KNOWN_TO_0_1, 10.20412, 0.00002, "+0.2 worse", Tone.WARN),
    ],
)
def test_a_difference_says_whether_it_is_better(
    name: IndicatorName,
    earlier: Aggregate,
    value: float,
    expanded: float | None,
    words: str,
    tone: Tone,
) -> None:
    known = None if expanded is None else Uncertainty(expanded / 2, expanded)
    _, _, difference = compared(name, value, known, earlier, 1 if expanded is not None else 2)
    assert (" ".join(difference.text.split()), difference.tone) == (words, tone)


# What is doubted, and how far values can be trusted.

TOUCH = "the touch rests on 1 sample"
EXPANDED = (0.018, 0.012, 0.02, 0.03, 0.041, 0.00031, 0.25)
"""Of the indicators but the last, which is a count."""
KNOWN = {
    name: Uncertainty(expanded / 2, expanded)
    for name, expanded in zip(IndicatorName, EXPANDED, strict=False)
}


def measured() -> dict[IndicatorName, Indicator]:
    """All indicators with uncertainties; two are doubted, one of them without a value."""
    found = {name: replace(one, uncertainty=KNOWN.get(name)) for name, one in indicators().items()}
    found[HANDLE] = replace(found[HANDLE], doubts=(TOUCH,))
    found[PASSAGE] = Indicator(None, "s", "door never closed", None, (TOUCH, "the door flickers"))
    return found


DOUBTED: Story = [(sets(indicators=measured()),), (Driver.run,), (Driver.finish,)]
DOUBTS = tuple(
    f"stamps of door and handle differ in delay by over one sampling interval, no {number}"
    for number in range(9)
)


def all_doubted() -> dict[IndicatorName, Indicator]:
    return {name: replace(one, doubts=DOUBTS) for name, one in measured().items()}


def earlier(time: float) -> RunSummary:
    return summary(values={**VALUES, TIME: time}, uncertainties=dict(KNOWN))


def row_of(lines: str, begin: str) -> list[str]:
    """The words of the row that begins so."""
    return next(row for row in lines.splitlines() if row.startswith(begin)).split()


@pytest.mark.parametrize("width", [57, 77])
def test_no_two_columns_touch_and_all_of_them_are_there(width: int) -> None:
    table = plain(IndicatorTable().draw_lines(measured_as(measured()), width))
    assert max(map(cell_len, table.splitlines())) <= width
    assert row_of(table, "execution time")[-4:] == ["17.43", "+-", "0.02", "s"]
    assert row_of(table, "smoothness")[-4:] == ["0.0625", "+-", "0.0004", "s^3/rad"]


VOID = Voiding(1.0, "wrong door", "Ada")


@pytest.mark.parametrize(
    ("runs", "changed", "words"),
    [
        ((17.4, 17.45, 17.42), {}, "17.42 +0.01 within +-"),
        ((17.4, None), {}, "worse"),  # without uncertainties a mean tells nothing apart
        ((16.0, 16.0, 16.0), {}, "16.00 +1.43 worse"),
        ((14.0, 16.0, 18.0), {}, "16 +1 within +-"),  # within the scatter of the earlier runs
        ((16.0,), {"voided": VOID}, "none: only completed runs that count"),
        ((16.0,), {"outcome": Outcome.TIMEOUT}, "none: only completed runs that count"),
    ],
)
def test_a_result_that_counts_is_compared_with_the_mean_of_earlier_ones(
    runs: Sequence[float | None], changed: Mapping[str, Any], words: str
) -> None:
    state = measured_as(measured())
    details = ResultDetails()
    details.earlier = [
        summary(values={TIME: 17.43}) if time is None else earlier(time) for time in runs
    ]
    state = replace(state, run=replace(state.run, **changed))
    text = plain(details.draw_lines(state, 110))
    assert words in " ".join(text.split())
    assert (f"mean of {len(runs)} earlier, difference to it" in text) is (not changed)
    assert ("worse" in text) is ("worse" in words)


# What is protested.

TEXT = "we were through earlier"
OVER: Story = [
    (sets(kind=SourceKind.ROS),),
    (Driver.run,),
    *(
        row
        for step in Step
        for row in ((engine_does(HandEngine.tick, 1.0),), (engine_does(HandEngine.do_step, step),))
    ),
    (Driver.finish,),
    (Driver.settle,),
]
"""A result is there, on a real testbed."""
PROTESTED: Story = [*OVER, (f"enter P 4 1 '={TEXT}' enter",)]
"""The team protests about step 4."""
SEVENTH = summary(7, protest_filed=EPOCH, protest_at=6.5)


def filed(text: str, team: str, about: str = "") -> Callable[[Driver], object]:
    return lambda driver: (
        isinstance(act := driver.engine.acts[-1], FileProtest)
        and (act.text, act.team) == (text, team)
        and about in act.about
    )


def refuses(why: str | None) -> Callable[[Driver], object]:
    """The engine refuses each act, or none any more."""

    def change(driver: Driver) -> None:
        driver.engine.put(instead=None if why is None else lambda _act: why)

    return change


STORIES: Stories = {
    "a result is shown whole": [
        (in_sizes(SMALL, LARGE),),
        (Driver.run,),
        ("i c i w =dent enter",),
        (Driver.finish, nothing_cut),
        (
            pages(
                "COMPLETED, valid (all six steps done)",
                "run 1 of subject 1 Door Bots, condition 1: pull, from CCW to CW, No Force",
                "version 1, not final. Enter: what next",
                "SIMULATED: not an official result",
                "execution time (hand start)    17.4320  s",
                "smoothness of door actuation    0.0625  s^3/rad",
                "capability level                     6  steps",
                "✓ 6 lock the door         1.005",
                "ruleset           protocol",
                "incident          +1.00 s collision",
                "note              +1.00 s dent",
                f"files             {FOLDER}",
            ),
            nothing_cut,
        ),
    ],
    "a reason stands apart from the name of its indicator": [
        (in_sizes(SMALL, LARGE),),
        (Driver.complete,),
        (
            shows(without("it never moved") | {TIME: Indicator(300.0, "s", None)}),
            "smoothness of door actuation none: it never moved",
            copied("smoothness of door actuation none: "),
        ),
    ],
    "a denied step is told as the referees word and never as the sensors": [
        *WITH_FLAGS,
        ("", ENDED, no("COMPLETED")),
        ("", " x 4 cross the threshold      no  denied (1.004) by Ada: a wheel stayed"),
        ("f3", "ENDED  3 of 6 steps count"),
    ],
    "a reason that all indicators have stands there once": [
        (acting(Driver.complete, Outcome.ABORTED),),
        (
            shows(without("run aborted: invalid")),
            lambda d: d.text.count("run aborted: invalid") == 1,
            "values            none: run aborted: invalid",
            "version 1. x is the next run",
        ),
    ],
    "the headline has the colour of the heaviest flag": [
        *WITH_FLAGS,
        ("", toned(ENDED, Tone.BAD)),
        # for information: among the marks
        ("enter a 1", toned(ENDED, Tone.WARN), toned("1 false start accepted", None)),
        ("", toned(ENDED, Tone.GOOD, rulings=(), incidents=(), faults=(), decided=())),
    ],
    "a step that is not done says why and v has all of it": [
        (in_sizes(SMALL, LARGE),),
        *WITH_FLAGS,
        (pages("comes after step 4", "step 4 denied: a wheel stayed on the line all the time"),),
    ],
    "a long reason does not run into the steps": [
        (in_sizes(SMALL, LARGE, (116, 40)),),
        (sets(indicators=indicators(missing=True)),),
        (Driver.complete, steps_apart),
    ],
    "a result does not say that something may still come": [
        (Driver.run,),
        (
            acting(Driver.finish, Outcome.TIMEOUT, "the team gives up"),
            "handle not touched",
            no("yet"),
        ),
    ],
    "values stand with uncertainty and doubt": [
        (in_sizes((60, 18), LARGE),),
        *DOUBTED,
        ("escape",),  # the message goes, and a page is as high as the next one
        (
            pages(
                "2 values to check: time to handle, passage time",
                "not final. Enter decides",
                "17.43 +- 0.02 s",
                "3.21? +- 0.02 s",
                "none: door never closed?",
                "0.0625 +- 0.0004 s^3/rad",
                "6 steps",
                f"doubt {TOUCH} (time to handle, passage time)",
                "doubt the door flickers (passage time)",
            ),
        ),
    ],
    "E packs the dossier of the marked run or the shown one": [
        (opened(runs=[summary(7)]),),
        (answered("escape h"),),
        (
            "enter E",
            says("Packing the dossier of"),
            lambda d: d.console.status == export_text(d.engine.snapshot().export),
        ),
        ("f4 enter", no("Dossier")),
        ("escape",),
        *OVER,
        (
            "f4 enter E",
            lambda d: (
                d.engine.sent(ExportDossier)
                == [ExportDossier(summary(7).folder), ExportDossier(Path(FOLDER).name)]
            ),
        ),
    ],
    "R says what to type where a spectator looks": [
        (opened(LARGE, runs=[SEVENTH]),),
        (answered("escape h"),),
        (
            "enter R",
            says("Type in another terminal: madrob watch --testbed replay"),
            says(f"/{SEVENTH.folder}"),
        ),
    ],
    "a result that the disk refuses is called so wherever it is met": [
        (Driver.run,),
        (sets(pulse=Pulse(refused="the result is NOT on disk: Read-only file system")),),
        (
            Driver.finish,
            "NOT ON DISK YET: only the engine has it, and goes on trying",
            says("The result is NOT ON DISK yet"),
            no("Enter: what next"),
        ),
        ("f10", "only the engine has it"),
        ("escape f3", "NOT ON DISK YET"),
        (sets(pulse=Pulse()),),
        ("f4",),
        (Driver.settle, no("NOT ON DISK"), "Enter: what next"),
        (has(pulse=Pulse(waiting=1)), no("NOT ON DISK")),
        ("f10", "A run is NOT ON DISK yet"),
    ],
    "a missing indicator says why": [
        (
            acting(Driver.complete, Outcome.TIMEOUT),
            "TIMEOUT, valid (because)",
            "passage time                 none: robot never reached the destination side",
        ),
    ],
    "an aborted run says so": [
        (acting(Driver.complete, Outcome.ABORTED), "ABORTED: invalid (because)"),
    ],
    "an interrupted run says so": [
        (Driver.complete,),
        (is_interrupted, "INTERRUPTED: does not count"),
    ],
    "a live result is not marked as simulated": [
        (on_engine(kind=SourceKind.ROS, label="LIVE ros domain 0"),),
        (Driver.complete, no("not an official result")),
    ],
    "nothing of an old result stays behind an abort": [
        (Driver.complete,),
        ("x f4", "No result yet", no("execution time")),
    ],
    "another result begins at its top": [
        (Driver.complete,),
        ("pagedown pagedown", no("COMPLETED")),
        ("x f6 f5",),
        (passes(6.0),),
        (Driver.finish, "COMPLETED", "run 2 of subject 1"),
    ],
    "what a decision hangs on is seen first": [
        (in_sizes((60, 18), LARGE),),
        *WITH_FLAGS,
        (
            "",
            "ENDED, valid (3 of 6 steps count: the referee denied step 4)",
            "1 false start UNDECIDED (handle touched)",
            "step 4 denied",
            no("1 incident (fall)"),
            lambda d: d.text.index("UNDECIDED") < d.text.index("run 1 of subject 1"),
            "not final. Enter decides",
            no("all six steps done"),
        ),
    ],
    "a result that was signed with something undecided says so": [
        (in_sizes(LARGE),),
        *WITH_FLAGS,
        (
            "enter f y a enter",
            "1 false start UNDECIDED (handle touched); step 4 denied",
            "signed by Ada, acknowledged by the team, with open questions",
            lambda d: "Enter" not in " ".join(d.rows()[:20]),
        ),
    ],
    "d accepts doubts and they stay beside the answer": [
        *DOUBTED,
        ("enter d", "a on all of them", "2 passage time: 2 doubts"),
        ("1", f"? {TOUCH}"),
        ("1", AcceptDoubts({HANDLE: (TOUCH,)}, "seen on video: right")),
        ("", "1 value to check: passage time", "3.21?"),
        ("enter d 2", no("to check:")),
        ("enter", "no doubt waits for the referee"),
        ("escape", copied("time to handle: seen on video: right")),
        ("z 1", "1 value to check: passage time"),
    ],
    "a result all of which is doubted is asked about on a small screen": [
        (sets(indicators=all_doubted()),),
        *DOUBTED[1:],
        ("enter d", *(f"{name.words}: 9 doubts" for name in IndicatorName)),
        ("a", "over one sampling interval,", "? and 5 more: the result has all of them"),
        ("", "o other: type it"),
        ("2", AcceptDoubts(dict.fromkeys(IndicatorName, DOUBTS), "no effect on the ranking")),
    ],
    "before a result is doubted the key says why not": [
        (Driver.run,),
        (Driver.finish,),
        ("enter", "Not now: d accept doubts: no doubt waits for the referee"),
    ],
    "words that the disk refuses are there again": [
        *OVER,
        (refuses("No space left on device"),),
        (f"enter P 4 1 '={TEXT}' enter", says("No space left on device")),
        ("", lambda d: not d.engine.run.protests),
        (refuses(None),),
        ("enter P 3 1", no(TEXT)),  # that is about another step
        ("escape enter P 4 1", TEXT),
        ("enter", lambda d: [one.text for one in d.engine.run.protests] == [TEXT]),
        (
            "enter P a 4 1",
            lambda d: [one.query_one(Input).value for one in d.console.dialogs] == [""],
        ),
    ],
    "the keys file, decide and withdraw": [
        (in_sizes(LARGE),),
        *PROTESTED,
        ("", filed(TEXT, "Door Bots", f"step 4: {Step.CROSS.text}")),
        ("enter P w 1", WithdrawProtest(1, "satisfied by the explanation")),
        (f"enter P t =2.5 enter 1 '={TEXT}' enter", filed(TEXT, "Door Bots")),
        (
            "enter P d r '=the video shows the foot' enter",
            DecideProtest(2, ProtestEnd.REJECTED, "the video shows the foot", "Ada"),
        ),
    ],
    "nothing is replayed while a run goes on and where there is none": [
        ("f4 enter", no("Replay")),
        ("escape",),
        (Driver.run,),
        ("f4 enter", "Note", no("Replay")),
    ],
}


@pytest.mark.parametrize("story", STORIES)
async def test_what_keys_do_and_what_is_seen_then(story: str) -> None:
    await play(HandEngine, STORIES[story])


# The runs before it.

CAUTION = replace(UNDECIDED_START, weight=FlagWeight.CAUTION, undecided=False)
REMARK = replace(CAUTION, weight=FlagWeight.REMARK)
WIDE = (120, 31)
RUNS = (
    summary(1, 1, 1, hour=0, team="Delft", source="simulated"),
    summary(2, 7, 1, hour=1, team="門の騎士", outcome=Outcome.TIMEOUT, values={}),
    summary(3, 13, 1, hour=2, team="🤖 Door Bots", final=True, team_word="acknowledged"),
    summary(1, 1, 2, hour=3, team="Delft", outcome=Outcome.ABORTED, values={}),
    summary(1, 1, 3, hour=4, team="Delft", outcome=Outcome.INTERRUPTED, source="replay"),
    summary(
        *(4, 20, 1),
        hour=5,
        team="Ghent",
        final=True,
        team_word="protested",
        issue=2,
        flags=(UNDECIDED_START,),
    ),
    summary(2, 7, 2, hour=6, team="", problem="result.json is damaged: make it again", source=None),
    summary(5, 5, 1, hour=7, team="Liège", outcome=None, values={}, source=None, issue=0),
)


class Results:
    """What the pane reads; a test changes it."""

    def __init__(self, runs: Sequence[RunSummary] = RUNS) -> None:
        self.runs = runs
        self.problem: Exception | None = None
        self.readings = 0
        self.may_end = threading.Event()
        self.may_end.set()

    def load(self) -> Sequence[RunSummary]:
        self.readings += 1
        runs, problem = self.runs, self.problem
        assert self.may_end.wait(10)
        if problem is not None:
            raise problem
        return runs


def teams(shown: Alone) -> list[str]:
    """Subject and run of the rows, from the top."""
    found = (row.replace("> ", "  ").split() for row in shown.rows())
    return [words[3] for words in found if len(words) > 3 and words[1] == "Nov"]


def test_the_line_below_says_what_does_not_fit() -> None:
    assert about(RUNS[5]) == (
        "1 false start UNDECIDED (handle touched); "
        "Ghent: pull, from CW to CCW, Wind Ramp; completed; version 2; protested; protocol; "
        + RUNS[5].folder
    )
    assert "it goes on, or it was cut off" in about(RUNS[7])
    assert about(RUNS[6]) == f"result.json is damaged: make it again (folder {RUNS[6].folder})"
    assert "condition 21 does not exist" in about(summary(1, 21))


def test_the_head_line_says_what_there_is() -> None:
    assert head_line(RUNS) == (
        "8 runs (1 PRACTICE): 4 valid, 1 INVALID, 1 INTERRUPTED, 1 DAMAGED, 1 unfinished"
    )
    assert head_line(RUNS[:1]) == "1 run (1 PRACTICE): 1 valid"
    assert head_line(()) == "no runs in the results folder"


async def test_the_screen_answers_while_it_reads_and_shows_the_last_reading() -> None:
    results = Results(RUNS[1:2])
    pane = HistoryPane(results.load)
    async with showing(pane) as shown:
        results.may_end.clear()
        results.runs = RUNS[:2]
        pane.reload()
        results.runs = RUNS[:3]
        await shown.drawn()
        pane.reload()
        await shown.pilot.press("down", "o", "v")
        assert "reading the results folder" in shown.text
        assert len(teams(shown)) == 1
        await shown.pilot.press("v", "v", "v")
        results.may_end.set()
        await shown.settle()
        assert len(teams(shown)) == 3
        assert "reading" not in shown.text


@pytest.mark.parametrize(
    "problem",
    [
        MadrobError("/results: cannot be used for results (Permission denied)"),
        OSError(24, "Too many open files"),
    ],
)
async def test_a_results_folder_that_cannot_be_read_is_a_line_on_the_screen(
    problem: Exception,
) -> None:
    results = Results()
    results.problem = problem
    pane = HistoryPane(results.load)
    async with showing(pane) as shown:
        assert str(problem) in shown.text
        results.problem = None
        pane.enter()
        await shown.settle()
        assert len(teams(shown)) == 8


async def test_it_reads_again_when_a_result_comes_or_changes_and_not_otherwise() -> None:
    results, snapshot = Results(), at_rest()
    pane = HistoryPane(results.load)
    later = replace(snapshot, time=snapshot.time + 1)
    first, second = (replace(snapshot, run=replace(snapshot.run, issue=n)) for n in (1, 2))
    async with showing(pane) as shown:
        for changed, readings in (
            (snapshot, 1),
            (later, 1),
            (first, 2),
            (replace(first), 2),
            (second, 3),
        ):
            pane.show(changed)
            await shown.settle()
            assert results.readings == readings


async def test_a_team_has_its_name_in_the_list_and_what_was_recorded_is_a_remark() -> None:
    runs = (
        summary(3, 1, 1, hour=0, team="Delft Wlkers"),
        summary(3, 1, 2, hour=1, team="Rotterdam", competition="Spring Cup"),  # no team of the list
    )
    state = replace(at_rest(), teams=TeamList({3: "Delft Walkers"}))
    pane = HistoryPane(Results(runs).load)

    def beside(name: str, *there: bool) -> Callable[[Alone], object]:
        return lambda shown: [name in row for row in shown.rows() if " Nov " in row] == [*there]

    def look_for(name: str, _shown: Alone) -> None:
        pane.look_for(f"team:{name}")

    rows: Story = [
        (lambda _: pane.show(state),),
        ("r down", beside(" Rotterdam ", True, False), beside(" Delft W", False, True)),
        ("", "Delft Walkers (recorded as Delft Wlkers): "),
        *(
            row
            for name in ("walkers", "wlkers")
            for row in (
                (partial(look_for, name),),
                (Alone.settle, numbered("3")),
            )
        ),
    ]
    await play_alone(pane, *rows, size=PANE)


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({}, "completed *"),
        ({"final": True}, "completed"),
        ({"final": True, "flags": (REMARK,)}, "completed"),
        ({"final": True, "flags": (CAUTION,)}, "completed !"),
        ({"flags": (UNDECIDED_START,)}, "completed *!!"),
        ({"flags": (UNDECIDED_START,), "protest_filed": EPOCH}, "completed P"),
        ({"flags": (CAUTION,), "voided": True}, "VOID"),
        ({"flags": (CAUTION,), "outcome": Outcome.ABORTED}, "INVALID"),
        ({"flags": (UNDECIDED_START,), "outcome": Outcome.INTERRUPTED}, "INTERRUP… *!!"),
    ],
)
def test_signs_say_what_must_be_decided_and_what_changed_a_score(
    told: dict[str, Any], words: str
) -> None:
    column = next(one for one in columns() if one.title == "outcome")
    shown = column.fit(column.cell(summary(1, **told)).text, column.width)
    assert shown.rstrip() == words


def numbered(*subjects: str) -> Callable[[Alone], object]:
    """These subjects have the rows, from the top."""
    return lambda shown: teams(shown) == [*subjects]


ALL = ("5", "2", "4", "1", "1", "3", "2", "1")


def one_simulated(shown: Alone) -> object:
    return [" 1 Delft " in row for row in shown.rows() if " SIM " in row] == [True]


COLUMNS = {column.title for column in columns()}
OF_COLUMNS = ("12.25", "1.875", "0.062", "14.75", "protested", "protocol", "Wind Ramp")


async def sees_every_column(shown: Alone) -> None:
    """One after the other; what a run is goes by marks, as `SIM`, in a column that stays near."""
    seen = ""
    for _ in COLUMNS:
        seen += shown.text
        await shown.press("right")
    assert [words for words in (*COLUMNS, *OF_COLUMNS) if words not in seen] == []
    assert "simulated" not in seen


HISTORY: dict[str, tuple[Sequence[RunSummary], tuple[int, int], Story]] = {
    **{
        f"all runs are shown newest first and marked by words: {size}": (
            RUNS,
            size,
            [
                ("", numbered(*ALL), lambda shown: "unfinished" in shown.marked),
                ("", "DAMAGED", "INVALID", "INTERRUPTED", "timeout", "completed !!"),
                ("", one_simulated, "6 17.43", "門の騎士"),
            ],
        )
        for size in (PANE, WIDE)
    },
    **{
        f"{words} finds such runs": (RUNS, PANE, [(f"slash '={words}'", numbered(*found))])
        for words, found in (
            ("official", ("4", "1", "3", "2")),
            ("practice", ("1",)),
        )
    },
    "in a terminal of 120 columns the marked run stands beside the list": (
        RUNS,
        WIDE,
        [
            ("end", lambda shown: "exec s    17.43" in shown.text),
            ("", lambda shown: len(shown.rows()[2]) > 76, "ruleset   protocol"),
        ],
    ),
    "the columns are sorted by one after the other": (
        RUNS,
        PANE,
        [
            ("greater_than_sign", "by subject", numbered("1", "1", "1", "2", "2", "3", "4", "5")),
            ("less_than_sign", "by start", numbered(*ALL)),
            ("o", numbered(*reversed(ALL))),
        ],
    ),
    "a filter is typed, kept with Enter and cleared with Escape": (
        RUNS,
        PANE,
        [
            ("", "/ filters", no("delft, cond:7")),
            ("slash", "delft, cond:7"),
            ("=delft", numbered("1", "1", "1")),
            ("space =inval enter", numbered("1"), "delft inval"),
            ("", "1-1 of 1, filtered from 8 (Escape shows all)"),
            ("slash v o", "no run passes the filter", numbered()),
            ("escape slash =foo:", "no field foo: there are subject, sub, cond, run, team"),
            ("escape", numbered(*ALL)),
            ("down", lambda shown: "DAMAGED" in shown.marked),  # the table has the focus again
        ],
    ),
    "an empty history says so and opens nothing": (
        (),
        PANE,
        [
            ("", "no runs in the results folder", "no runs yet"),
            ("enter o o right end pagedown v", lambda shown: shown.app.sent == []),
        ],
    ),
    "enter opens the marked run": (
        RUNS,
        PANE,
        [("down down enter", lambda shown: [one.row for one in shown.app.sent] == [RUNS[5]])],
    ),
    "a value that is doubted is marked and has the digits that it has": (
        [
            summary(
                uncertainties=dict(KNOWN),
                doubts={TIME: 1, PASSAGE: 2},
                values={name: value for name, value in VALUES.items() if name != PASSAGE},
            )
        ],
        (220, 24),
        [("", " 6 17.43? 3.21 push, from CCW to CW 4.50 -? 1.88 0.0625 14.8")],
    ),
    "runs of a team can be asked for": (
        RUNS,
        PANE,
        [
            (
                "slash '=subject:1 cond:1' enter",
                numbered("1", "1", "1"),
                " subject:1 cond:1",
                "filtered from 8",
            ),
        ],
    ),
    "every column can be seen on a small screen": (
        RUNS,
        PANE,
        [(sees_every_column,)],
    ),
}


@pytest.mark.parametrize("story", HISTORY)
async def test_what_keys_do_in_the_history(story: str) -> None:
    runs, size, rows = HISTORY[story]
    await play_alone(HistoryPane(Results(runs).load), *rows, size=size)


def test_the_words_about_a_run_say_that_it_was_practice() -> None:
    assert "PRACTICE, version" in about(summary(practice=True))
    assert "PRACTICE" not in about(summary())
