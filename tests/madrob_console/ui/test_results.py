from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import pytest

from madrob_console.archive.history import RunSummary
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import date_of
from madrob_console.common.names import SourceKind
from madrob_console.engine.snapshot import Pulse
from madrob_console.engine.view import NO_STEPS
from madrob_console.pages.tally import Aggregate
from madrob_console.referee.evidence_account import EvidenceAccount, RecordedTopic
from madrob_console.referee.flags import FlagWeight
from madrob_console.referee.lists import TeamList
from madrob_console.referee.records import RemovedEvidence, Voiding
from madrob_console.referee.records import TestbedFault as Fault
from madrob_console.referee.run import Run
from madrob_console.ui.cells.lines import Line, Tone
from madrob_console.ui.panes.result_pane import (
    ResultDetails,
    ResultHead,
    ResultsPane,
    compared,
    mark_words,
)
from madrob_console.ui.panes.runs_pane import HistoryPane, about, columns
from madrob_console.ui.panes.runs_pane import summary as head_line
from scoring.indicator_table import IndicatorName
from scoring.procedure import Ruling
from scoring.protocol import Outcome, Step
from scoring.result import Indicator
from tests.madrob_console.run_folders import EPOCH, UNDECIDED_START, summary
from tests.madrob_console.ui.driver import (
    LARGE,
    PANE,
    SMALL,
    Driver,
    Shown,
    Stories,
    acting,
    driving,
    has,
    in_sizes,
    no,
    on_engine,
    passes,
    play,
    play_pane,
    says,
    sets,
    showing,
)
from tests.madrob_console.ui.fake_engine import FOLDER, FakeEngine


async def finished(driver: Driver, outcome: Outcome = Outcome.COMPLETED) -> None:
    await driver.run()
    for step in Step:
        driver.engine.do_step(step)
    await driver.finish(outcome, "because")


async def whole_text(driver: Driver) -> str:
    """The pane from top to bottom."""
    text = driver.text
    for _ in range(4):
        await driver.press("pagedown")
        text += driver.text
    return text


@pytest.mark.parametrize("size", [SMALL, LARGE])
async def test_a_result_is_shown_whole(running: Driver, engine: FakeEngine) -> None:
    await running.press("i", "c", "i", "n", *"dent", "enter")
    for step in Step:
        engine.do_step(step)
    await running.finish()
    text = await whole_text(running)
    for words in (
        "COMPLETED, valid (step 6 is done)",
        "run 1 of subject 1 Door Bots, condition 1: pull, from CCW to CW, No Force",
        "issue 1, not final: Enter signs, rules, corrects; v details",
        "SIMULATED: not an official result",
        "execution time, manual start   17.4320  s",
        "smoothness of door actuation    0.0625  s^3/rad",
        "capability level                     6  steps",
        "✓ 6 lock the door         1.000",
        "ruleset           protocol",
        "door angle           1221  50.0    21.3    0    0.8    4.0    0     0    0",
        "incident          +1.00 s collision",
        "note              +1.00 s dent",
        f"files             {FOLDER}",
    ):
        assert words in " ".join(text.splitlines()) or words in text
    assert "…" not in text.replace(running.rows()[0], "")


@pytest.mark.parametrize("size", [SMALL, LARGE])
async def test_a_reason_stands_apart_from_the_name_of_its_indicator(
    driver: Driver, engine: FakeEngine
) -> None:
    await finished(driver)
    assert engine.result is not None
    found = {name: Indicator(None, "", "it never moved") for name in IndicatorName}
    found[IndicatorName.EXECUTION_TIME] = Indicator(300.0, "s", None)
    engine.result = replace(engine.result, indicators=found)
    await driver.settle()
    assert "smoothness of door actuation none: it never moved" in driver.text
    assert "smoothness of door actuation none: " in driver.console.panes.results.copied


async def test_a_denied_step_is_told_as_the_referees_word_and_never_as_the_sensors(
    driver: Driver,
) -> None:
    await with_flags(driver)
    assert "ENDED, valid (3 of 6 steps count: the referee denied step 4)" in driver.text
    assert "COMPLETED" not in driver.text
    row = next(row for row in driver.rows() if "4 cross the threshold" in row)
    assert row.startswith(" x 4 cross the threshold      no  denied (1.000) by Ada: a wheel stayed")
    await driver.press("f3")
    assert "ENDED  3 of 6 steps count" in driver.text


async def with_flags(driver: Driver) -> None:
    """Completed by the sensors, with nearly everything that a referee should know at once."""
    engine = driver.engine
    await driver.set_up()
    await driver.press("f5")
    engine.false_start()
    await driver.let_pass(6.0)
    for step in Step:
        engine.do_step(step)
    await driver.press("i", "f")
    denial = Ruling(Step.CROSS, False, engine.now, "a wheel stayed on the line all the time", "Ada")
    why = {4: f"denied by the referee: {denial.reason}", 5: "comes after step 4", 6: "..."}
    engine.steps = tuple(
        replace(record, final=None, reason=why[record.step]) if record.step in why else record
        for record in engine.steps
    )
    cross = replace(engine.steps[3], referee=denial)
    engine.steps = (*engine.steps[:3], cross, *engine.steps[4:])
    fault = Fault(engine.now, "/madrob/door/angle: lost")
    engine.run = replace(engine.run, rulings=(denial,), faults=(fault,))
    await driver.finish(reason="all six steps done")


async def test_a_reason_that_all_indicators_have_stands_there_once(
    driver: Driver, engine: FakeEngine
) -> None:
    await finished(driver, Outcome.ABORTED)
    assert engine.result is not None
    none = {name: Indicator.missing(name, "run aborted: invalid") for name in IndicatorName}
    engine.result = replace(engine.result, indicators=none)
    await driver.settle()
    assert driver.text.count("run aborted: invalid") == 1
    assert "values            none: run aborted: invalid" in driver.text
    assert "issue 1, counts nowhere: x is the next run; v details" in driver.text


def toned(driver: Driver, width: int = 78) -> dict[str, Tone]:
    """The words of the result's head, with their tones."""
    lines = ResultHead().draw_lines(driver.engine.snapshot(), width)
    return {span.text: span.tone for row in lines for span in row}


async def test_the_headline_has_the_colour_of_the_heaviest_flag(
    driver: Driver, engine: FakeEngine
) -> None:
    await with_flags(driver)
    headline = "ENDED, valid (3 of 6 steps count: the referee denied step 4)"
    assert toned(driver)[headline] is Tone.BAD
    await driver.press("enter", "a", "1")
    assert toned(driver)[headline] is Tone.WARN
    assert "1 false start accepted" not in toned(driver)  # for information: among the marks
    engine.run = replace(engine.run, rulings=(), incidents=(), faults=(), decided=())
    assert toned(driver)[headline] is Tone.GOOD


@pytest.mark.parametrize("size", [SMALL, LARGE, (160, 50)])
async def test_a_step_that_is_not_done_says_why_and_v_has_all_of_it(driver: Driver) -> None:
    await with_flags(driver)
    text = " ".join((await whole_text(driver)).split())
    assert "comes after step 4" in text
    assert "step 4 denied: a wheel stayed on the line all the time" in text


@pytest.mark.parametrize("size", [SMALL, LARGE, (116, 40), (160, 50)])
async def test_a_long_reason_does_not_run_into_the_steps(
    driver: Driver, size: tuple[int, int]
) -> None:
    await finished(driver, Outcome.TIMEOUT)
    side_by_side = size[0] >= 120
    seen = 0
    for row in driver.rows():
        for step in Step:
            left, found, _ = row.partition(f"✓ {step} {step.text}")
            seen += bool(found)
            assert not found or not left.strip() or left.endswith("  ")
            assert not found or bool(left.strip()) == side_by_side
    assert seen == len(Step)


async def test_values_and_steps_of_an_ordinary_result_fill_20_rows_and_v_turns_to_its_details(
    engine: FakeEngine,
) -> None:
    engine.kind = SourceKind.ROS
    async with driving(engine) as driver:
        await with_flags(driver)
        snapshot = engine.snapshot()
    pane = ResultsPane(lambda: ())
    async with showing(pane, (80, 20)) as shown:
        pane.show(snapshot)
        await shown.settle()
        first = shown.text
        for name in IndicatorName:
            assert name.words in first
        for step in Step:
            assert f"{step} {step.text}" in first
        assert "data quality" not in first
        await shown.press("v")
        assert "comparison" in shown.text
        assert "data quality" in shown.text
        assert "execution time" not in shown.text
        await shown.press("v")
        assert shown.text == first


async def test_the_newest_mark_comes_first(driver: Driver) -> None:
    await finished(driver)
    assert driver.engine.result is not None
    said = ("first", "second")
    rulings = tuple(Ruling(Step.CROSS, True, 5.0, words, "Ada") for words in said)
    run = Run(rulings=rulings, voided=Voiding(4.0, "wrong door", "Ada"))
    words = [text.split()[-1] for _, text in mark_words(run, driver.engine.result)]
    assert words[-3:] == ["second", "first", "door"]


@pytest.mark.parametrize(
    ("name", "value", "words", "tone"),
    [
        (IndicatorName.EXECUTION_TIME, 9.0, "-1.0000 better", Tone.GOOD),
        (IndicatorName.EXECUTION_TIME, 12.0, "+2.0000 worse", Tone.WARN),
        (IndicatorName.CAPABILITY_LEVEL, 12, "+2.0000 better", Tone.GOOD),
        (IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION, 9.0, "-1.0000 worse", Tone.WARN),
        (IndicatorName.PASSAGE_TIME, 10.0, "+0.0000 equal", Tone.PLAIN),
    ],
)
def test_a_difference_says_whether_it_is_better(
    name: IndicatorName, value: float, words: str, tone: Tone
) -> None:
    earlier = Aggregate.of([10.0, 10.0])
    assert earlier is not None
    _, _, difference = compared(name, value, None, earlier, 2)
    assert (" ".join(difference.text.split()), difference.tone) == (words, tone)


async def test_a_result_does_not_say_that_something_may_still_come(
    running: Driver, engine: FakeEngine
) -> None:
    first, *others = NO_STEPS
    engine.steps = (replace(first, reason="handle not touched yet"), *others)
    await running.finish(Outcome.TIMEOUT, "the team gives up")
    assert "handle not touched" in running.text
    assert "yet" not in running.text


@pytest.mark.parametrize("size", [SMALL, LARGE])
async def test_evidence_that_was_removed_is_not_shown_as_if_it_were_there(
    driver: Driver, engine: FakeEngine, size: tuple[int, int]
) -> None:
    await finished(driver)
    snapshot = engine.snapshot()
    assert snapshot is not None
    topic = RecordedTopic("/cam", "sensor_msgs/msg/Image", messages=881, bytes=34_300_000)
    run = replace(snapshot.run, evidence=EvidenceAccount((topic,)))
    there = replace(snapshot, run=run)
    gone = replace(run, removed_evidence=(RemovedEvidence(1.7e9, 1, 34_300_000),))
    words = "1 topic, 881 messages, 34.3 MB"
    assert shown(ResultDetails().draw_lines(there, size[0])).endswith(words)
    told = shown(ResultDetails().draw_lines(replace(snapshot, run=gone), size[0]))
    assert " ".join(told.split()).endswith(f"{words}; removed by tidy on {date_of(1.7e9)}")


def shown(lines: Sequence[Line]) -> str:
    return "\n".join("".join(span.text for span in row) for row in lines)


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
        self.problem: str | OSError = ""
        self.readings = 0
        self.may_end = threading.Event()
        self.may_end.set()

    def load(self) -> Sequence[RunSummary]:
        self.readings += 1
        runs, problem = self.runs, self.problem
        assert self.may_end.wait(10)
        if isinstance(problem, OSError):
            raise problem
        if problem:
            raise MadrobError(problem)
        return runs


def teams(shown: Shown) -> list[str]:
    """Subject and run of the rows, from the top."""
    numbers = []
    for row in shown.rows():
        words = row.replace("> ", "  ").split()
        if len(words) > 3 and words[1] == "Nov":
            numbers.append(words[3])
    return numbers


def test_the_line_below_says_what_does_not_fit() -> None:
    assert about(RUNS[5]) == (
        "1 false start UNDECIDED (handle touched); "
        "Ghent: pull, from CW to CCW, Wind Ramp; completed; issue 2; protested; protocol; "
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


async def test_enter_opens_the_marked_run() -> None:

    pane = HistoryPane(Results().load)
    async with showing(pane) as shown:
        await shown.press("down", "down", "enter")
        (sent,) = shown.app.sent
        assert isinstance(sent, HistoryPane.Opened)
        assert sent.row == pane.table.selected == RUNS[5]


async def test_runs_of_a_team_can_be_asked_for() -> None:

    pane = HistoryPane(Results().load)
    async with showing(pane) as shown:
        await shown.press("v")
        pane.look_for("subject:1 cond:1")
        await shown.settle()
        assert teams(shown) == ["1", "1", "1"]
        assert " subject:1 cond:1" in shown.text
        assert "3 of 8 runs: filtered" in shown.text


async def test_the_screen_answers_while_it_reads_and_shows_the_last_reading() -> None:

    results = Results(RUNS[1:2])
    pane = HistoryPane(results.load)
    async with showing(pane) as shown:
        results.may_end.clear()
        results.runs = RUNS[:2]
        pane.reload()
        results.runs = RUNS[:3]
        await shown.pilot.pause()
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
        "/results: cannot be used for results (Permission denied)",
        OSError(24, "Too many open files"),
    ],
)
async def test_a_results_folder_that_cannot_be_read_is_a_line_on_the_screen(
    problem: str | OSError,
) -> None:

    results = Results()
    results.problem = problem
    pane = HistoryPane(results.load)
    async with showing(pane) as shown:
        assert str(problem) in shown.text
        results.problem = ""
        pane.enter()
        await shown.settle()
        assert len(teams(shown)) == 8


async def test_it_reads_again_when_a_result_comes_or_changes_and_not_otherwise(
    engine: FakeEngine,
) -> None:

    results = Results()
    pane = HistoryPane(results.load)
    async with showing(pane) as shown:
        snapshot = engine.snapshot()
        for changed, readings in (
            (snapshot, 1),
            (replace(snapshot, time=snapshot.time + 1), 1),
            (replace(snapshot, run=replace(snapshot.run, issue=1)), 2),
            (replace(snapshot, run=replace(snapshot.run, issue=1)), 2),
            (replace(snapshot, run=replace(snapshot.run, issue=2)), 3),
        ):
            pane.show(changed)
            await shown.settle()
            assert results.readings == readings


async def test_a_team_has_its_name_in_the_list_and_what_was_recorded_is_a_remark(
    engine: FakeEngine,
) -> None:
    runs = (
        summary(3, 1, 1, hour=0, team="Delft Wlkers"),
        summary(3, 1, 2, hour=1, team="Rotterdam", competition="Spring Cup"),  # no team of the list
    )

    pane = HistoryPane(Results(runs).load, "Autumn Cup")
    async with showing(pane, WIDE) as shown:
        engine.teams = TeamList({3: "Delft Walkers"})
        pane.show(engine.snapshot())
        await shown.press("r", "down")
        assert [" Rotterdam " in row for row in shown.rows() if " Nov " in row] == [True, False]
        assert [" Delft W" in row for row in shown.rows() if " Nov " in row] == [False, True]
        assert "Delft Walkers (recorded as Delft Wlkers): " in shown.text
        for name in ("walkers", "wlkers"):
            pane.look_for(f"team:{name}")
            await shown.settle()
            assert teams(shown) == ["3"]


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
    run = summary(1, **told)
    (column,) = (one for one in columns() if one.title == "outcome")
    shown = column.fit(column.cell(run).text, column.width)
    assert shown.rstrip() == words


STORIES: Stories = {
    "a result that the disk refuses is called so wherever it is met": [
        (in_sizes(SMALL, LARGE),),
        (Driver.run,),
        (sets(pulse=Pulse(refused="the result is NOT on disk: Read-only file system")),),
        (
            Driver.finish,
            "NOT ON DISK YET: only the engine has it, and goes on trying",
            says("The result is NOT ON DISK yet"),
            no("Enter signs"),
        ),
        ("f10", "only the engine has it"),
        ("escape f3", "NOT ON DISK YET"),
        (sets(pulse=Pulse()),),
        ("f4",),
        (Driver.settle, no("NOT ON DISK"), "Enter signs"),
        (has(pulse=Pulse(waiting=1)), no("NOT ON DISK")),
        ("f10", "A run is NOT ON DISK yet"),
    ],
    "the first screen shows outcome and all indicators": [
        (finished, "COMPLETED", "execution time", "capability level"),
    ],
    "a missing indicator says why": [
        (
            acting(finished, Outcome.TIMEOUT),
            "TIMEOUT, valid (because)",
            "passage time                 none: robot never reached the destination side",
        ),
    ],
    **{
        f"an outcome that does not count says so: {outcome}, {words}": [
            (acting(finished, outcome), words),
        ]
        for outcome, words in [
            (Outcome.ABORTED, "ABORTED: the run is invalid (because)"),
            (Outcome.INTERRUPTED, "INTERRUPTED: the machine failed, left out of every aggregate"),
        ]
    },
    "a live result is not marked as simulated": [
        (on_engine(kind=SourceKind.ROS, label="LIVE ros domain 0"),),
        (finished, no("not an official result")),
    ],
    "before a result the pane says so": [
        ("f4", "No result yet"),
    ],
    "nothing of an old result stays behind an abort": [
        (finished,),
        ("x f4", "No result yet", no("execution time")),
    ],
    "another result begins at its top": [
        (finished,),
        ("pagedown pagedown", no("COMPLETED")),
        ("x f6 f5",),
        (passes(6.0),),
        (Driver.finish, "COMPLETED", "run 2 of subject 1"),
    ],
    "what a decision hangs on is seen first": [
        (in_sizes((60, 18), SMALL, LARGE, (160, 50)),),
        (
            with_flags,
            "ENDED, valid (3 of 6 steps count: the referee denied step 4)",
            "1 false start UNDECIDED (handle touched)",
            "step 4 denied",
            "1 testbed fault",
            no("1 incident (fall)"),
            lambda d: d.text.index("UNDECIDED") < d.text.index("run 1 of subject 1"),
            "not final: Enter decides; v details",
            no("all six steps done"),
        ),
        ("f3", no("all six steps done")),
    ],
    "a result that was signed with something undecided says so": [
        (in_sizes(LARGE),),
        (with_flags,),
        (
            "enter f y a enter",
            "1 false start UNDECIDED (handle touched); step 4 denied",
            "acknowledged by the team, signed Ada with what is undecided",
            lambda d: "Enter" not in " ".join(d.rows()[:20]),
        ),
    ],
}


@pytest.mark.parametrize("story", STORIES)
async def test_what_keys_do_and_what_is_seen_then(story: str) -> None:
    await play(FakeEngine, STORIES[story])


def numbered(*subjects: str) -> Callable[[Shown], object]:
    """These subjects have the rows, from the top."""
    return lambda shown: teams(shown) == [*subjects]


def misses(words: str) -> Callable[[Shown], object]:
    return lambda shown: words not in shown.text


ALL = ("5", "2", "4", "1", "1", "3", "2", "1")


def one_simulated(shown: Shown) -> object:
    return [" 1 Delft " in row for row in shown.rows() if " SIM " in row] == [True]


OF_WIDE = ("pull, from CW to CCW", "P protest  * not final")
COLUMNS = {column.title for column in columns()}
OF_COLUMNS = ("12.25", "1.875", "0.062", "14.75", "protested", "protocol", "Wind Ramp")
HISTORY: dict[str, tuple[Sequence[RunSummary], tuple[int, int], Sequence[tuple[Any, ...]]]] = {
    **{
        f"all runs are shown newest first and marked by words: {size}": (
            RUNS,
            size,
            [
                ("", numbered(*ALL), lambda shown: "unfinished" in shown.marked),
                ("", "DAMAGED", "INVALID", "INTERRUPTED", "timeout", "completed !!"),
                ("", one_simulated, "6 17.43", "門の騎士"),
                ("", *(seen if size == WIDE else misses(seen) for seen in OF_WIDE)),
            ],
        )
        for size in (PANE, WIDE)
    },
    "v shows official runs, then practice, then those that are not final": (
        RUNS,
        PANE,
        [
            ("", "v official only"),
            (
                "v",
                numbered("5", "2", "4", "1", "3", "2"),
                "6 of 8 runs: official only",
                "v practice",
            ),
            ("v", numbered("1"), "1 of 8 runs: practice only (Escape shows all)", "v not final"),
            ("v", numbered("5", "2", "1", "1", "2", "1"), "6 of 8 runs: not final", "v all runs"),
            ("v", numbered(*ALL)),
        ],
    ),
    "a filter is typed, kept with Enter and cleared with Escape": (
        RUNS,
        PANE,
        [
            ("", "/ filters: delft, cond:7"),
            ("slash d e l f t", numbered("1", "1", "1")),
            ("space i n v a l enter", numbered("1"), "delft inval"),
            ("", "1 of 8 runs: filtered (Escape shows all)"),
            ("slash v o", "no run passes the filter", numbered()),
            ("escape slash f o o colon", "no field foo: there are subject, sub, cond, run, team"),
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
}


@pytest.mark.parametrize("story", HISTORY)
async def test_what_keys_do_in_the_history(story: str) -> None:
    runs, size, rows = HISTORY[story]
    await play_pane(HistoryPane(Results(runs).load), *rows, size=size)


async def test_every_column_can_be_seen_on_a_small_screen() -> None:
    seen = ""
    async with showing(HistoryPane(Results().load)) as shown:
        for _ in COLUMNS:
            seen += shown.text
            await shown.press("right")
    assert [words for words in (*COLUMNS, *OF_COLUMNS) if words not in seen] == []
    assert "simulated" not in seen  # the mark is `SIM`, in a column that stays near
