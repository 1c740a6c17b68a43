from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from madrob_console.archive.collection import matches
from madrob_console.archive.history import RunSummary
from madrob_console.engine.snapshot import ExportView
from madrob_console.pages.tally import standings
from madrob_console.referee.flags import FlagWeight
from madrob_console.ui.cells.lines import Tone
from madrob_console.ui.look.words import export_text
from madrob_console.ui.panes.standings_pane import (
    PRACTICE_BANNER,
    StandingsPane,
    about,
    filter_for,
)
from scoring.protocol import Outcome
from tests.madrob_console.run_folders import UNDECIDED_START, VALUES, summary, write
from tests.madrob_console.ui.driver import DEFAULTS, PANE, Shown, driving, play_pane, row, showing
from tests.madrob_console.ui.fake_engine import FakeEngine

TITLES = (
    *("subj", "team", "cond", "task", "compl", "timeo", "inval", "exec s", "hand s", "occup s"),
    *("pass s", "unsafe", "smooth", "rough N", "level", "door", "inter", "open", "ruleset"),
    "testbeds",
)


def timed(subject: int, time: float, **fields: Any) -> RunSummary:  # noqa: ANN401  as `summary`
    """A run with an execution time."""
    return summary(subject, **{"values": {**VALUES, "execution_time": time}, **fields})


OFFICIAL = (
    timed(1, 10.0, team="Delft"),
    timed(1, 20.0, team="Delft"),
    timed(1, 60.0, team="Delft"),
    timed(1, 300.0, team="Delft", outcome=Outcome.TIMEOUT),
    timed(2, 15.0, team="門の騎士"),
    timed(2, 1.0, team="門の騎士", outcome=Outcome.ABORTED, values={}),
)
PRACTICE = (timed(1, 99.0, team="Delft", source="simulated"),)


def pane_of(runs: Sequence[RunSummary], best: int = 0) -> StandingsPane:
    return StandingsPane(lambda: runs, best, "Autumn Cup")


async def test_each_condition_begins_with_the_team_that_leads_it() -> None:
    """By level, then by time, as on the published overview."""
    low = {**VALUES, "execution_time": 300.0, "capability_level": 3}
    runs = (
        *OFFICIAL,
        timed(3, 5.0, condition=1, team="Ghent"),
        timed(4, 12.5, team="Delft University Door Openers"),
        summary(5, team="Pisa", outcome=Outcome.TIMEOUT, values=low),
        timed(6, 1.0, team="Oslo", outcome=Outcome.ABORTED, values={}),
    )

    pane = pane_of(runs)
    async with showing(pane) as shown:
        rows = [" ".join(row.split()) for row in shown.rows()]
        first = rows.index("> 1 3 Ghent 6 5.00 1")
        assert rows[first + 1 : first + 6] == [
            "7 1 Delft 6 10.00 4",
            "7 4 Delft University Door Openers 6 12.50 1",
            "7 2 門の騎士 6 15.00 1",
            "7 5 Pisa 3 timeout 1",
            "7 6 Oslo - - 0",
        ]
        assert "Each team's best run: level, then time. The protocol makes no ranking." in rows
        assert PRACTICE_BANNER not in shown.text
        strong = [
            any(span.tone is Tone.STRONG for span in line[2:]) for line in pane.table.page(76, 8)
        ]
        assert strong[2:7] == [True, False, False, False, False]


async def test_each_ruleset_has_a_leader_of_its_own_and_they_are_not_compared() -> None:
    pane = pane_of((*OFFICIAL, timed(2, 1.0, team="門の騎士", ruleset="eurobench-2020")))
    async with showing(pane) as shown:
        assert "2 rulesets: do not compare them." in " ".join(shown.text.split())
        assert pane.table.strong == {"2/7/eurobench-2020", "1/7/protocol"}


HALLS = [timed(1, 10.0, testbed="A", rate=50.0), timed(2, 20.0, testbed="B", rate=100.0)]
SAME_RATE = [HALLS[0], timed(2, 20.0, testbed="B", rate=50.0)]
OTHERS = [timed(1, 1.0, team="Zebra", competition="Spring Cup")]
CAUTION = replace(UNDECIDED_START, weight=FlagWeight.CAUTION, undecided=False)
FLAGGED = (
    timed(1, 10.0, team="Delft", flags=(UNDECIDED_START,)),
    timed(2, 15.0, team="Ghent", flags=(CAUTION,)),
    timed(3, 9.0, team="Pisa"),
    timed(4, 8.0, team="Turin", protest_filed=0.0),
    timed(5, 8.0, team="Vienna", protest_filed=0.0, flags=(CAUTION,)),
)
DAMAGED = timed(3, 1.0, team="Ghent", problem="result.json is damaged")


def misses(words: str) -> Callable[[Shown], object]:
    return lambda shown: words not in shown.text


def marked(words: str) -> Callable[[Shown], object]:
    return lambda shown: words in shown.marked


def of_team(team: str, words: str) -> Callable[[Shown], object]:
    return lambda shown: words in next(row for row in shown.rows() if team in row)


class Story(NamedTuple):
    """What is pressed and seen, with which runs, of which the `best` count."""

    runs: Sequence[RunSummary]
    rows: Sequence[tuple[Any, ...]]
    best: int = 0
    size: tuple[int, int] = PANE


STORIES = {
    "a team of another competition is another team": Story(
        (*OFFICIAL, *OTHERS),
        rows=[("", row("> 7 1 Delft 6 10.00 4"), "1 not of this competition.")],
    ),
    "v shows counts and means over all valid runs": Story(
        (*OFFICIAL, *PRACTICE),
        size=(140, 30),
        rows=[
            (
                "v",
                row("> 7 1 Delft 30.00 3.21 4.50 12.25 1.875 0.0625 14.75 6.00 3 1"),
                row("mean over all valid runs (exec s: completed ones)."),
                "Delft: 3 completed, 1 timeout; push, from CCW to CW, Constant Force",
            )
        ],
    ),
    "testbeds that differ are told in the head line": Story(
        HALLS,
        rows=[("", "The testbeds differ: sampling rate 50 Hz (A), 100 Hz (B).")],
    ),
    "testbeds that do not differ are not": Story(SAME_RATE, [("", misses("differ"))]),
    "a team with flagged runs is marked and the line below counts them": Story(
        FLAGGED,
        rows=[
            (
                "",
                row("> 7 4 Turin 6 8.00 1 P"),
                row("7 5 Vienna 6 8.00 1 P"),
                row("7 3 Pisa 6 9.00 1"),
                row("7 1 Delft 6 10.00 1 !!"),
                row("7 2 Ghent 6 15.00 1 !"),
                "2 PROTESTS open: NOT FINAL.",
                "Turin: 1 completed, NOT FINAL: 1 PROTEST open",
            )
        ],
    ),
    "v goes through the statistics": Story(
        OFFICIAL,
        size=(120, 30),
        rows=[
            (key, words, of_team("Delft ", delft), of_team("騎士", knights))
            for key, words, delft, knights in (
                ("v", "mean over", " 30.00 ", " 15.00 "),
                ("v", "median over", " 20.00 ", " 15.00 "),
                ("v", "std over", " 26.46 ", " - "),
                ("v", "min over", " 1.875 ", " 1.875 "),
                ("v", "max over", " 1.875 ", " 1.875 "),
                ("v", "best run", " 10.00 ", " 15.00 "),
            )
        ],
    ),
    "so many best runs enter as the settings say": Story(
        OFFICIAL,
        best=2,
        rows=[("v", "mean over the best 2 valid runs", marked(" 15.00 "))],
    ),
    "official runs stand there without practice": Story(
        (*OFFICIAL, *PRACTICE),
        rows=[("", misses(PRACTICE_BANNER), marked(" 10.00 "))],
    ),
    "practice runs stand there where there are no others": Story(
        PRACTICE,
        rows=[("", PRACTICE_BANNER, marked(" 99.00 "))],
    ),
    "without runs it says so": Story(
        (),
        rows=[("", "no official runs yet", misses(PRACTICE_BANNER))],
    ),
    "damaged results are left out and counted": Story(
        (*OFFICIAL, DAMAGED),
        rows=[("", "1 DAMAGED left out.", misses("Ghent"))],
    ),
}


@pytest.mark.parametrize("story", STORIES)
async def test_what_keys_do_and_what_is_seen_then(story: str) -> None:
    runs, rows, best, size = STORIES[story]
    await play_pane(pane_of(runs, best), *rows, size=size)


async def test_every_column_can_be_seen_and_sorted_by_on_a_small_screen() -> None:
    async with showing(pane_of(OFFICIAL)) as shown:
        await shown.press("v")
        seen, sorted_by = "", set()
        for _ in TITLES:
            seen += shown.text
            for _ in range(2 * 8):
                sorted_by.add(re.findall(r"of 2, by (\w+(?: \w+)*)", shown.text)[0])
                await shown.press("o")
                assert any("▲" in row or "▼" in row for row in shown.rows())
            await shown.press("right")
        assert all(title in seen for title in TITLES)
        assert len(sorted_by) == len(TITLES) + 1  # and by what is open


async def test_enter_asks_for_the_runs_of_the_marked_team() -> None:

    pane = pane_of(OFFICIAL)
    async with showing(pane) as shown:
        await shown.press("down", "enter")
        (sent,) = shown.app.sent
        assert isinstance(sent, StandingsPane.Opened)
        assert pane.table.selected is not None
        assert sent.row == pane.table.selected
        wanted = filter_for(pane.table.selected)
        assert [run for run in OFFICIAL if matches(run, wanted)] == list(OFFICIAL[4:])


def test_a_row_is_said_in_words() -> None:
    runs = [
        summary(outcome=outcome, condition=20)
        for outcome in (Outcome.COMPLETED, Outcome.ABORTED, Outcome.INTERRUPTED, None)
    ]
    (standing,) = standings(runs)
    assert about(standing) == (
        "Team 3: 1 completed, 1 INVALID, 1 INTERRUPTED, 1 without a result yet; "
        "pull, from CW to CCW, Wind Ramp; ruleset protocol"
    )


ZIP = "/results/exports/team_003_Delft_20261121_182139.zip"


@pytest.mark.parametrize(
    ("export", "text"),
    [
        (ExportView(3), "Packing the runs of subject 3 in the background ..."),
        (
            ExportView(3, ZIP),
            "Packed: /results/exports/team_003_Delft_20261121_182139.zip (y copies it)",
        ),
        (ExportView(3, "/home/a.zip"), "Packed: /home/a.zip (y copies it)"),
        (
            ExportView(3, "/home/a.zip", "b.csv: cannot be read"),
            "Packed, but not all (b.csv: cannot be read): /home/a.zip (y copies it)",
        ),
        (ExportView(3, "", "the disk is full"), "No zip of subject 3: the disk is full"),
    ],
)
def test_a_line_says_what_has_become_of_an_export(export: ExportView, text: str) -> None:
    assert export_text(export) == text


@pytest.mark.parametrize("practice", [True, False])
async def test_e_packs_official_or_practice_runs_as_the_marked_one_is(
    engine: FakeEngine, tmp_path: Path, *, practice: bool
) -> None:
    write(tmp_path, summary(7, practice=practice))

    async with driving(engine, defaults=replace(DEFAULTS, results=tmp_path)) as driver:
        await driver.answered("escape", "h")
        await driver.press("enter", "e")
        assert engine.exported == [-7 if practice else 7]


async def test_e_packs_the_team_of_the_marked_runs_competition(
    engine: FakeEngine, tmp_path: Path
) -> None:
    write(tmp_path, summary(7, competition="Spring Cup", hour=1))
    write(tmp_path, summary(7))

    async with driving(engine, defaults=replace(DEFAULTS, results=tmp_path)) as driver:
        await driver.answered("escape", "h")
        await driver.press("enter", "e")
        await driver.press("down", "enter", "e")
        assert engine.exported_of == ["Spring Cup", "Autumn Cup"]


async def test_e_packs_the_team_of_the_run_or_the_marked_one_and_says_where_the_zip_is(
    engine: FakeEngine, tmp_path: Path
) -> None:
    write(tmp_path, summary(7))
    defaults = replace(DEFAULTS, results=tmp_path)

    async with driving(engine, defaults=defaults) as driver:
        await driver.answered("escape", "h")
        await driver.press("enter")
        assert "e Zip" in driver.text
        await driver.press("e")
        assert engine.exported == [7]
        assert driver.console.status == export_text(ExportView(7))
        engine.export = ExportView(7, f"{tmp_path}/exports/a.zip")
        await driver.settle()
        assert driver.console.status == f"Packed: {tmp_path}/exports/a.zip (y copies it)"
        await driver.press("f3")
        await driver.run()
        await driver.finish()
        await driver.press("f4", "enter", "e")
        assert engine.exported == [7, -1]  # a simulated run is practice
