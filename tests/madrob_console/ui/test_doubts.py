"""What is doubted, and how far values can be trusted: on every screen on which values stand."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from rich.cells import cell_len

from madrob_console.archive.history import RunSummary
from madrob_console.common.names import SourceKind
from madrob_console.pages.tally import Aggregate
from madrob_console.referee.acts import AcceptDoubts
from madrob_console.referee.records import Voiding
from madrob_console.ui.cells.lines import plain
from madrob_console.ui.panes.result_pane import IndicatorTable, ResultDetails, compared
from madrob_console.ui.panes.runs_pane import HistoryPane
from madrob_console.ui.panes.standings_pane import StandingsPane
from madrob_console.ui.wall import PAGE_TIME
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
from scoring.result import Indicator, Uncertainty
from tests.madrob_console.run_folders import VALUES, summary, write
from tests.madrob_console.ui.driver import (
    LARGE,
    SMALL,
    Driver,
    Stories,
    in_sizes,
    no,
    play,
    play_pane,
    showing,
)
from tests.madrob_console.ui.fake_engine import FakeEngine, indicators
from tests.madrob_console.ui.test_wall import hall

TOUCH = "the touch rests on 1 sample"
TIME = IndicatorName.EXECUTION_TIME
HANDLE = IndicatorName.TIME_TO_HANDLE
PASSAGE = IndicatorName.PASSAGE_TIME
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


async def doubted(driver: Driver) -> None:
    """A run is over, and its result is doubted."""
    await driver.run()
    driver.engine.finish()
    assert driver.engine.result is not None
    driver.engine.result = replace(driver.engine.result, indicators=measured())
    await driver.settle()


@pytest.mark.parametrize("size", [(60, 18), SMALL, LARGE, (160, 50)])
async def test_values_stand_with_uncertainty_and_doubt(driver: Driver) -> None:
    await doubted(driver)
    await driver.press("escape")  # the message goes, and a page is as high as the next one
    text = driver.text
    for _ in range(4):
        await driver.press("pagedown")
        text += "\n" + driver.text
    shown = " ".join(text.split())
    for words in (
        "doubted: time to handle, passage time (2 doubts UNDECIDED)",
        "not final: Enter decides",
        "17.43 +- 0.02 s",
        "3.21? +- 0.02 s",
        "none: door never closed?",
        "0.0625 +- 0.0004 s^3/rad",
        "6 steps",
        f"doubt {TOUCH} (time to handle, passage time)",
        "doubt the door flickers (passage time)",
    ):
        assert words in shown, (words, text)


def earlier(time: float) -> RunSummary:
    return summary(values={**VALUES, TIME: time}, uncertainties=dict(KNOWN))


@pytest.mark.parametrize("width", [57, 77])
@pytest.mark.parametrize("size", [LARGE])
async def test_no_two_columns_touch_and_all_of_them_are_there(
    driver: Driver, engine: FakeEngine, width: int
) -> None:
    await doubted(driver)
    rows = plain(IndicatorTable().draw_lines(engine.snapshot(), width)).splitlines()
    assert max(map(cell_len, rows)) <= width
    row = next(one for one in rows if one.startswith("execution time"))
    assert row.split()[-4:] == ["17.43", "+-", "0.02", "s"]
    smooth = next(one for one in rows if one.startswith("smoothness"))
    assert smooth.split()[-4:] == ["0.0625", "+-", "0.0004", "s^3/rad"]
    details = ResultDetails()
    details.earlier = [earlier(17.4), earlier(17.45), earlier(17.42)]
    rows = plain(details.draw_lines(engine.snapshot(), width)).splitlines()
    row = next(one for one in rows if one.startswith("execution time"))
    assert row.split()[2:] == ["17.42", "+0.01", "within", "+-"]
    assert rows[0].endswith("mean of 3 earlier, difference to it")


@pytest.mark.parametrize(
    ("value", "expanded", "words"),
    [
        (10.2, 0.1, "+0.2 within +-"),
        (10.5, 0.1, "+0.5 worse"),
        (9.5, 0.1, "-0.5 better"),
        (10.0, 0.1, "+0.0 within +-"),
        (10.0, None, "+0.0000 equal"),
        (10.2, None, "+0.2000 worse"),
        (60.0, 0.0, "+50.0 worse"),  # exact, but the mean is not
        (10.20412, 0.00002, "+0.2 worse"),
    ],
)
def test_a_difference_within_the_uncertainties_is_neither_better_nor_worse(
    value: float, expanded: float | None, words: str
) -> None:
    known = None if expanded is None else Uncertainty(expanded / 2, expanded)
    earlier = Aggregate.of([10.0], [Uncertainty(0.05, 0.1)])
    assert earlier is not None
    _, _, difference = compared(TIME, value, known, earlier, 1)
    assert " ".join(difference.text.split()) == words


@pytest.mark.parametrize("size", [LARGE])
async def test_the_mean_of_earlier_runs_without_uncertainties_tells_nothing_apart(
    driver: Driver, engine: FakeEngine
) -> None:
    await doubted(driver)
    table = ResultDetails()
    table.earlier = [earlier(17.4), summary(values={TIME: 17.43})]
    row = next(
        one
        for one in plain(table.draw_lines(engine.snapshot(), 110)).splitlines()
        if one.startswith("execution time")
    )
    assert "worse" in row


@pytest.mark.parametrize("size", [LARGE])
async def test_a_difference_within_the_scatter_of_the_earlier_runs_is_neither_better_nor_worse(
    driver: Driver, engine: FakeEngine
) -> None:
    await doubted(driver)
    table = ResultDetails()
    rows = []
    for times in ((16.0, 16.0, 16.0), (14.0, 16.0, 18.0)):
        table.earlier = [earlier(time) for time in times]
        text = plain(table.draw_lines(engine.snapshot(), 110)).splitlines()
        rows.append(next(one for one in text if one.startswith("execution time")))
    assert rows[0].split()[-3:] == ["16.00", "+1.43", "worse"]
    assert rows[1].split()[-4:] == ["16", "+1", "within", "+-"]


@pytest.mark.parametrize("size", [LARGE])
async def test_a_run_that_failed_or_is_void_is_compared_with_nothing(
    driver: Driver, engine: FakeEngine
) -> None:
    await doubted(driver)
    table = ResultDetails()
    table.earlier = [earlier(16.0)]
    snapshot = engine.snapshot()
    run = snapshot.run
    void = replace(run, voided=Voiding(1.0, "wrong door", "Ada"))
    failed = replace(run, outcome=Outcome.TIMEOUT)
    for each, words in ((run, True), (void, False), (failed, False)):
        text = plain(table.draw_lines(replace(snapshot, run=each), 110))
        assert ("mean of 1 earlier, difference to it" in text) is words
        assert ("worse" in text) is words
        assert ("none: only completed runs that count" in text) is not words


async def test_the_history_marks_a_doubted_value_with_the_digits_that_it_has() -> None:
    run = summary(uncertainties=dict(KNOWN), doubts={TIME: 1, PASSAGE: 2}, values={
        name: value for name, value in VALUES.items() if name != PASSAGE
    })  # fmt: skip

    async with showing(HistoryPane(lambda: [run]), (180, 24)) as shown:
        row = next(" ".join(one.split()) for one in shown.rows() if "Team 3" in one)
        assert " 6 17.43? 3.21 push, from CCW to CW 4.50 -? 1.88 0.0625 14.8" in row


ALIKE = [
    summary(subject, values={**VALUES, TIME: time}, uncertainties=dict(KNOWN), doubts=doubts)
    for subject, time, doubts in ((1, 17.43, {}), (2, 17.44, {TIME: 1}), (3, 19.0, {}))
]


@pytest.mark.parametrize("size", [(60, 18), (80, 24), (160, 50)])
async def test_the_wall_shows_them_too(
    engine: FakeEngine, tmp_path: Path, size: tuple[int, int]
) -> None:

    engine.kind, engine.label = SourceKind.ROS, "LIVE ros"
    for run in ALIKE[::-1]:
        write(tmp_path, run)
    async with hall(engine, tmp_path, size) as wall:
        text = wall.text
        assert re.search(r"execution time +17\.44\? +\+- 0\.02 +s", text) or (
            re.search(r"execution time +1\d\.\d\d", text)
        )
        await wall.let_pass(PAGE_TIME)
        assert wall.size_of("2 Team 2") >= 0
        assert wall.size_of("17.44?~") >= 0
        assert "~ not distinguish" in wall.text


WORDS = "stamps of door and handle differ in delay by over one sampling interval, no {}"
DOUBTS = tuple(WORDS.format(number) for number in range(9))


async def all_doubted(driver: Driver) -> None:
    await doubted(driver)
    assert driver.engine.result is not None
    found = {name: replace(one, doubts=DOUBTS) for name, one in measured().items()}
    driver.engine.result = replace(driver.engine.result, indicators=found)
    await driver.settle()


def copied(words: str) -> Callable[[Driver], object]:
    return lambda driver: words in driver.console.panes.results.copied


STORIES: Stories = {
    "d accepts doubts and they stay beside the answer": [
        (in_sizes(SMALL, LARGE),),
        (doubted,),
        ("enter d", "a on all of them", "2 passage time: 2 doubts"),
        ("1", f"? {TOUCH}"),
        ("1", AcceptDoubts({HANDLE: (TOUCH,)}, "seen on video: right")),
        ("", "doubted: passage time (2 doubts UNDECIDED)", "3.21?"),
        ("enter d 2", no("doubted:")),
        ("enter", "no doubt waits for the referee"),
        ("escape", copied("time to handle: seen on video: right")),
        ("z 1", "doubted: passage time (2 doubts UNDECIDED)"),
    ],
    "a result all of which is doubted is asked about on a small screen": [
        (all_doubted,),
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
}


@pytest.mark.parametrize("story", STORIES)
async def test_what_keys_do_and_what_is_seen_then(story: str) -> None:
    await play(FakeEngine, STORIES[story])


async def test_the_standings_mark_teams_that_do_not_differ() -> None:
    await play_pane(
        StandingsPane(lambda: ALIKE, 0, "Autumn Cup"),
        ("", lambda shown: shown.marked.split()[:5] == [">", "7", "1", "Team", "1"]),
        ("", "17.43~ ", "17.44?~ ", "19.00 "),
        ("", "? doubted ~ not distinguishable", "execution time ~ 2;"),
    )


async def test_without_a_sign_no_row_is_lost_to_their_meaning() -> None:
    pane = StandingsPane(lambda: [summary()], 0, "Autumn Cup")
    await play_pane(pane, ("", lambda shown: "doubted" not in shown.text))
