from __future__ import annotations

import asyncio
import threading
from collections.abc import Sequence
from dataclasses import replace

import pytest

from madrob_console.archive.history import RunSummary
from madrob_console.errors import MadrobError
from madrob_console.referee.teams import TeamList
from madrob_console.ui.panes.history_columns import columns
from madrob_console.ui.panes.history_pane import HistoryPane, about
from madrob_console.ui.panes.history_pane import summary as head_line
from scoring.protocol import Outcome
from tests.madrob_console.run_folders import EPOCH, UNDECIDED_START, summary
from tests.madrob_console.ui.fake_engine import FakeEngine
from tests.madrob_console.ui.pane_app import PANE, Shown, showing

LARGE = (120, 31)
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


@pytest.mark.parametrize("size", [PANE, LARGE])
def test_all_runs_are_shown_newest_first_and_marked_by_words(size: tuple[int, int]) -> None:
    async def drive() -> None:
        async with showing(HistoryPane(Results().load), size) as shown:
            assert teams(shown) == ["5", "2", "4", "1", "1", "3", "2", "1"]
            assert "unfinished" in shown.marked
            for words in ("DAMAGED", "INVALID", "INTERRUPTED", "timeout", "completed !!"):
                assert words in shown.text
            (practice,) = (row for row in shown.rows() if " SIM " in row)
            assert " 1 Delft " in practice
            assert "門の騎士" in shown.text
            assert "6   17.43    3.21" in shown.text
            assert ("pull, from CW to CCW" in shown.text) == (size == LARGE)

    asyncio.run(drive())


def test_every_column_can_be_seen_on_a_small_screen() -> None:
    async def drive() -> None:
        async with showing(HistoryPane(Results().load)) as shown:
            seen = ""
            for _ in range(len(columns())):
                seen += shown.text
                await shown.press("right")
            for column in columns():
                assert column.title in seen
            for words in ("12.25", "1.875", "0.062", "14.75", "protested", "protocol", "Wind Ramp"):
                assert words in seen
            assert "simulated" not in seen  # the mark is `SIM`, in a column that stays near

    asyncio.run(drive())


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


def test_v_shows_those_not_final_then_those_that_do_not_count() -> None:
    async def drive() -> None:
        async with showing(HistoryPane(Results().load)) as shown:
            await shown.press("v")
            assert teams(shown) == ["5", "2", "1", "1", "2", "1"]
            assert "6 of 8 runs: not final" in shown.text
            await shown.press("v")
            assert teams(shown) == ["4"]
            assert "1 of 8 runs: undecided" in shown.text
            await shown.press("v")
            assert teams(shown) == ["5", "2", "1", "1"]
            assert "4 of 8 runs: invalid and interrupted" in shown.text
            await shown.press("v")
            assert teams(shown) == []
            assert "0 of 8 runs: protest open" in shown.text
            await shown.press("v")
            assert len(teams(shown)) == 8

    asyncio.run(drive())


def test_a_filter_is_typed_kept_with_enter_and_cleared_with_escape() -> None:
    async def drive() -> None:
        pane = HistoryPane(Results().load)
        async with showing(pane) as shown:
            await shown.press("slash", *"delft")
            assert "filter delft" in shown.text
            assert teams(shown) == ["1", "1", "1"]
            await shown.press("space", *"inval", "enter")
            assert teams(shown) == ["1"]
            assert "1 of 8 runs: filter 'delft inval' (Escape clears it)" in shown.text
            assert "filter delft" not in shown.text
            await shown.press("slash", *"vo")
            assert "filter vo" in shown.text
            assert "no run passes the filter" in shown.text
            assert pane.selected is None
            await shown.press("escape", "slash", *"foo", "colon")
            assert "no field foo: there are subject, sub, cond, run, team" in shown.text
            await shown.press("escape")
            assert len(teams(shown)) == 8
            await shown.press("down")  # the table has the focus again
            assert pane.selected == RUNS[6]

    asyncio.run(drive())


def test_enter_opens_the_marked_run() -> None:
    async def drive() -> None:
        pane = HistoryPane(Results().load)
        async with showing(pane) as shown:
            await shown.press("down", "down", "enter")
            (sent,) = shown.app.sent
            assert isinstance(sent, HistoryPane.Opened)
            assert sent.row == pane.selected == RUNS[5]

    asyncio.run(drive())


def test_an_empty_history_says_so_and_opens_nothing() -> None:
    async def drive() -> None:
        async with showing(HistoryPane(Results(()).load)) as shown:
            assert "no runs in the results folder" in shown.text
            assert "no runs yet" in shown.text
            await shown.press("enter", "o", "O", "right", "end", "pagedown", "v")
            assert shown.app.sent == []

    asyncio.run(drive())


def test_runs_of_a_team_can_be_asked_for() -> None:
    async def drive() -> None:
        pane = HistoryPane(Results().load)
        async with showing(pane) as shown:
            await shown.press("v")
            pane.look_for("subject:1 cond:1")
            await shown.settle()
            assert teams(shown) == ["1", "1", "1"]
            assert "3 of 8 runs: filter 'subject:1 cond:1'" in shown.text

    asyncio.run(drive())


def test_the_screen_answers_while_it_reads_and_shows_the_last_reading() -> None:
    async def drive() -> None:
        results = Results(RUNS[:1])
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
            await shown.pilot.press("v", "v", "v", "v")
            results.may_end.set()
            await shown.settle()
            assert len(teams(shown)) == 3
            assert "reading" not in shown.text

    asyncio.run(drive())


@pytest.mark.parametrize(
    "problem",
    [
        "/results: cannot be used for results (Permission denied)",
        OSError(24, "Too many open files"),
    ],
)
def test_a_results_folder_that_cannot_be_read_is_a_line_on_the_screen(
    problem: str | OSError,
) -> None:
    async def drive() -> None:
        results = Results()
        results.problem = problem
        pane = HistoryPane(results.load)
        async with showing(pane) as shown:
            assert str(problem) in shown.text
            results.problem = ""
            pane.enter()
            await shown.settle()
            assert len(teams(shown)) == 8

    asyncio.run(drive())


def test_it_reads_again_when_a_result_comes_or_changes_and_not_otherwise(
    engine: FakeEngine,
) -> None:
    async def drive() -> None:
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

    asyncio.run(drive())


def test_a_team_has_its_name_in_the_list_and_what_was_recorded_is_a_remark(
    engine: FakeEngine,
) -> None:
    runs = (
        summary(3, 1, 1, hour=0, team="Delft Wlkers"),
        summary(3, 1, 2, hour=1, team="Rotterdam", competition="Spring Cup"),  # no team of the list
    )

    async def drive() -> None:
        pane = HistoryPane(Results(runs).load, "Autumn Cup")
        async with showing(pane, LARGE) as shown:
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

    asyncio.run(drive())


@pytest.mark.parametrize(
    ("outcome", "words"),
    [(Outcome.COMPLETED, "completed P!!"), (Outcome.INTERRUPTED, "INTERRUP… P!!")],
)
def test_signs_stand_apart_from_the_outcome_and_are_never_cut(outcome: Outcome, words: str) -> None:
    run = summary(1, outcome=outcome, protest_due=EPOCH, flags=(UNDECIDED_START,))
    (column,) = (one for one in columns() if one.title == "outcome")
    shown = column.fit(column.cell(run).text, column.width)
    assert shown.rstrip() == words
