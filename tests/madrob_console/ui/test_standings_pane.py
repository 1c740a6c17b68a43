from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import pytest

from madrob_console.archive.collection import matches
from madrob_console.engine.requests import ExportTeam
from madrob_console.engine.snapshot import ExportView
from madrob_console.pages.tally import Standing, standings
from madrob_console.referee.flags import FlagWeight
from madrob_console.referee.run_summary import RunSummary
from madrob_console.ui.cells.lines import Tone, plain
from madrob_console.ui.cells.table import Table
from madrob_console.ui.look.words import export_text
from madrob_console.ui.panes.standings_pane import (
    PRACTICE_BANNER,
    StandingsPane,
    about,
    filter_for,
)
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
from scoring.result import Uncertainty
from tests.madrob_console.run_folders import UNDECIDED_START, VALUES, summary
from tests.madrob_console.ui.driver import (
    PANE,
    Alone,
    Driver,
    Stories,
    Story,
    answered,
    has,
    no,
    opened,
    play,
    play_alone,
    row,
    says_only,
    showing,
)
from tests.madrob_console.ui.inline_engine import HandEngine

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
    pane = StandingsPane(lambda: runs, best)
    pane.competition = "Autumn Cup"
    return pane


LOW = {**VALUES, "execution_time": 300.0, "capability_level": 3}
LED = (
    *OFFICIAL,
    timed(3, 5.0, condition=1, team="Ghent"),
    timed(4, 12.5, team="Delft University Door Openers"),
    summary(5, team="Pisa", outcome=Outcome.TIMEOUT, values=LOW),
    timed(6, 1.0, team="Oslo", outcome=Outcome.ABORTED, values={}),
)
TWO_RULESETS = (*OFFICIAL, timed(2, 1.0, team="門の騎士", ruleset="eurobench-2020"))
"""Each has a leader of its own, and they are not compared."""


def table_of(shown: Alone) -> Table[Standing]:
    return shown.app.query_one(StandingsPane).table


def strong(*rows: bool) -> Callable[[Alone], object]:
    """Whether the second and the following rows are."""
    return lambda shown: (
        [
            any(span.tone is Tone.STRONG for span in line[2:])
            for line in table_of(shown).page(76, 8)[2 : 2 + len(rows)]
        ]
        == [*rows]
    )


def in_order(*rows: str) -> Callable[[Alone], object]:
    """These rows stand one below the other, their blanks aside."""
    wanted = "\n".join(rows)
    return lambda shown: wanted in "\n".join(" ".join(row.split()) for row in shown.rows())


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


def marked(words: str) -> Callable[[Alone], object]:
    return lambda shown: words in shown.marked


def of_team(team: str, words: str) -> Callable[[Alone], object]:
    return lambda shown: words in next(row for row in shown.rows() if team in row)


ALIKE = [
    summary(
        subject,
        hour=float(subject == 2),
        values={**VALUES, "execution_time": time},
        uncertainties={IndicatorName.EXECUTION_TIME: Uncertainty(0.009, 0.018)},
        doubts=doubts,
    )
    for subject, time, doubts in (
        (1, 17.43, {}),
        (2, 17.44, {IndicatorName.EXECUTION_TIME: 1}),
        (3, 19.0, {}),
    )
]


class Case(NamedTuple):
    """What is pressed and seen, with which runs, of which the `best` count."""

    runs: Sequence[RunSummary]
    rows: Story
    best: int = 0
    size: tuple[int, int] = PANE


STORIES = {
    # by level, then by time, as on the published overview
    "each condition begins with the team that leads it": Case(
        LED,
        rows=[
            (
                "",
                in_order(
                    "> 1 3 Ghent 6 5.00 1",
                    "7 1 Delft 6 10.00 4",
                    "7 4 Delft University Door Openers 6 12.50 1",
                    "7 2 門の騎士 6 15.00 1",
                    "7 5 Pisa 3 timeout 1",
                    "7 6 Oslo - - 0",
                ),
                row("Each team's best run: level, then time. The protocol makes no ranking."),
                no(PRACTICE_BANNER),
                strong(True, False, False, False, False),
            )
        ],
    ),
    "each ruleset has a leader of its own and they are not compared": Case(
        TWO_RULESETS,
        rows=[
            (
                "",
                "2 rulesets: do not compare them.",
                lambda shown: table_of(shown).strong == {"2/7/eurobench-2020", "1/7/protocol"},
            )
        ],
    ),
    "teams that do not differ are marked": Case(
        ALIKE,
        rows=[
            ("", lambda shown: shown.marked.split()[:5] == [">", "7", "1", "Team", "1"]),
            ("", "17.43 ", "17.44? ", "19.00 "),  # best runs
            ("v", "17.43~ ", "17.44?~ ", "19.00 "),  # means
            ("", "? doubted ~ a tie", "execution time ~ 2"),
        ],
    ),
    "without a sign no row is lost to their meaning": Case([summary()], rows=[("", no("doubted"))]),
    "enter asks for the runs of the marked team": Case(
        OFFICIAL,
        rows=[
            (
                "down enter",
                lambda shown: [one.row for one in shown.app.sent] == [table_of(shown).selected],
                lambda shown: (
                    (marked := table_of(shown).selected)
                    and [run for run in OFFICIAL if matches(run, filter_for(marked))]
                    == list(OFFICIAL[4:])
                ),
            )
        ],
    ),
    "a team of another competition is another team": Case(
        (*OFFICIAL, *OTHERS),
        rows=[("", row("> 7 1 Delft 6 10.00 4"), "1 not of this competition.")],
    ),
    "v shows counts and means over all valid runs": Case(
        (*OFFICIAL, *PRACTICE),
        size=(180, 30),
        rows=[
            (
                "v",
                " 7     1 Delft",
                row("mean over all valid runs (exec s: completed ones)."),
                "Delft: 3 completed, 1 timeout",
            )
        ],
    ),
    "testbeds that differ are told in the head line": Case(
        HALLS,
        rows=[("", "The testbeds differ: sampling rate 50 Hz (A), 100 Hz (B).")],
    ),
    "testbeds that do not differ are not": Case(SAME_RATE, [("", no("differ"))]),
    "a team with flagged runs is marked and the line below counts them": Case(
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
    "v goes through the statistics": Case(
        OFFICIAL,
        size=(110, 30),
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
    "so many best runs enter as the settings say": Case(
        OFFICIAL,
        best=2,
        rows=[("v", "mean over the best 2 valid runs", marked(" 15.00 "))],
    ),
    "official runs stand there without practice": Case(
        (*OFFICIAL, *PRACTICE),
        rows=[("", no(PRACTICE_BANNER), marked(" 10.00 "))],
    ),
    "practice runs stand there where there are no others": Case(
        PRACTICE,
        rows=[("", PRACTICE_BANNER, marked(" 99.00 "))],
    ),
    "without runs it says so": Case(
        (),
        rows=[("", "no official runs yet", no(PRACTICE_BANNER))],
    ),
    "damaged results are left out and counted": Case(
        (*OFFICIAL, DAMAGED),
        rows=[("", "1 DAMAGED left out.", no("Ghent"))],
    ),
}


@pytest.mark.parametrize("story", STORIES)
async def test_what_keys_do_and_what_is_seen_then(story: str) -> None:
    runs, rows, best, size = STORIES[story]
    await play_alone(pane_of(runs, best), *rows, size=size)


async def test_every_column_can_be_seen_and_sorted_by_on_a_small_screen() -> None:
    """By the keys of a table, which move and sort as here."""
    pane = pane_of(OFFICIAL)
    async with showing(pane) as shown:
        await shown.press("v")
        seen, sorted_by = "", set()
        for _ in (*TITLES, "what is open"):
            seen += plain(pane.table.page(*PANE))
            for _ in range(2 * 8):
                below = plain(pane.table.page(*PANE)[-1:])
                sorted_by.add(re.findall(r"of 2, by (\w+(?: \w+)*)", below)[0])
                pane.table.action_turn()
                head = plain(pane.table.page(*PANE)[:1])
                assert "▲" in head or "▼" in head
            pane.table.action_sort(1)
        assert all(title in seen for title in TITLES)
        assert len(sorted_by) == len(TITLES) + 1  # and by what is open


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


PRACTISED = summary(7, practice=True)
SPRING = summary(7, competition="Spring Cup", hour=1)


def packed(*teams: ExportTeam) -> Callable[[Driver], object]:
    return lambda driver: driver.engine.sent(ExportTeam) == [*teams]


PACKED: Stories = {
    **{
        f"e packs official or practice runs as the marked one is: {practice}": [
            (opened(runs=[run]),),
            (answered("escape h"),),
            ("enter e", packed(ExportTeam(7, practice, "Autumn Cup"))),
        ]
        for run, practice in ((summary(7), False), (PRACTISED, True))
    },
    "e packs the team of the marked runs competition": [
        (opened(runs=[SPRING, summary(7)]),),
        (answered("escape h"),),
        ("enter e",),
        (
            "down enter e",
            packed(ExportTeam(7, False, "Spring Cup"), ExportTeam(7, False, "Autumn Cup")),
        ),
    ],
    "e packs the team of the run or the marked one and says where the zip is": [
        (opened(runs=[summary(7)]),),
        (answered("escape h"),),
        ("enter", "e Zip"),
        ("e", says_only(export_text(ExportView(7)))),
        (
            has(export=ExportView(7, "/exports/a.zip")),
            says_only("Packed: /exports/a.zip (y copies it)"),
        ),
        ("f3",),
        (Driver.run,),
        (Driver.finish,),
        # a simulated run is practice
        (
            "f4 enter e",
            packed(ExportTeam(7, False, "Autumn Cup"), ExportTeam(1, True, "Autumn Cup")),
        ),
    ],
}


@pytest.mark.parametrize("story", PACKED)
async def test_e_packs_runs(story: str) -> None:
    await play(HandEngine, PACKED[story])
