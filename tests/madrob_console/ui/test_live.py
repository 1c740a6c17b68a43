from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from madrob_console.common.formatting import format_size
from madrob_console.common.names import SourceKind
from madrob_console.engine.snapshot import (
    EvidenceView,
    Pulse,
    RecorderView,
    RightToAct,
    Snapshot,
)
from madrob_console.referee.acts import Abort
from madrob_console.referee.checks import Freshness
from madrob_console.referee.journal import Origin
from madrob_console.testbeds.simulated import Scenario
from madrob_console.ui.cells.lines import Line, Tone, plain, width_of
from madrob_console.ui.look.words import ROUGH
from madrob_console.ui.panes.all_faults import EvidenceLine
from madrob_console.ui.panes.live_pane import Provisional
from madrob_console.ui.panes.run_status import clock_span, step_lines
from madrob_console.ui.wall import step_cells
from scoring.indicator_table import IndicatorName
from scoring.procedure import Ruling
from scoring.protocol import Condition, Side, Step
from scoring.result import Result
from scoring.rulesets import RulesetName
from tests.madrob_console.engine.drive import STEP, Drive, make_setup
from tests.madrob_console.ui.driver import DEFAULTS, LARGE, SMALL, Driver, driving
from tests.madrob_console.ui.fake_engine import FakeEngine

SIZES = pytest.mark.parametrize("size", [SMALL, LARGE])


@SIZES
async def test_the_live_pane_shows_the_whole_run(running: Driver, engine: FakeEngine) -> None:
    engine.angle, engine.force, engine.maximum = 0.31, 12.3, 15.2
    engine.do_step(Step.TOUCH)
    await running.let_pass(1.25)
    engine.do_step(Step.UNLOCK)
    engine.do_step(Step.OPEN)
    engine.say("door opens")
    engine.provisional = {"time_to_handle": 1.0}
    for _ in range(3):  # the log waits for every third look
        await running.settle()
    for text in (
        "RUNNING  4:58 left of 5:00",
        "run 1 of subject 1 Door Bots",
        "condition 1: pull, from CCW to CW, No Force",
        "next: step 4 cross the threshold",
        "✓ 1 touch the handle      1.000",
        "✓ 3 open the door         2.250",
        "> 4 cross the threshold      no",
        "  6 lock the door            no",
        "door +0.310 rad  +17.8 deg open",
        "handle raw +12.30 zero +0.00 max 15.2N",
        "touch at 1.96 N",
        "so far  to handle 1.000 s occupation - passage -  6 of 6 fresh",
        "   +2.25 sensor  door opens",
    ):
        assert text in running.text
    assert "…" not in "".join(running.rows()[1:])


async def test_the_clock_reads_the_time_in_large_digits(running: Driver) -> None:
    await running.let_pass(63.0)  # 1:04.0
    rows = [row[10:31].rstrip() for row in running.rows()[2:5]]
    assert rows == [
        "▀█  ▄ █▀█ █ █   █▀█",
        " █  ▄ █ █ ▀▀█   █ █",
        "▀▀▀   ▀▀▀   ▀ ▀ ▀▀▀",
    ]


@pytest.mark.parametrize(
    ("size", "rows"), [((80, 24), 3), ((120, 36), 5), ((160, 50), 8), ((300, 80), 13)]
)
async def test_the_clock_grows_with_the_terminal(running: Driver, rows: int) -> None:
    await running.let_pass(63.0)
    drawn = [row for row in running.rows()[2 : 2 + rows + 2] if {"█", "▀"} & set(row[:60])]
    assert len(drawn) == rows
    assert "RUNNING" in running.text
    assert "run 1 of subject 1" in running.text


async def _resized(driver: Driver, size: tuple[int, int]) -> Sequence[str]:
    await driver.pilot.resize_terminal(*size)
    await driver.let_pass(1.0)
    return driver.rows()


@pytest.mark.parametrize("size", [(120, 36)])
async def test_the_clock_follows_a_terminal_that_is_resized(running: Driver) -> None:
    large = len([row for row in running.rows()[2:9] if "█" in row])
    small = len([row for row in (await _resized(running, (120, 30)))[2:9] if "█" in row])
    again = len([row for row in (await _resized(running, (120, 36)))[2:9] if "█" in row])
    assert small < large == again


@pytest.mark.parametrize("width", [60, 64, 70, 80, 90, 100, 110, 130, 160, 200])
async def test_no_column_touches_or_cuts_the_next(engine: FakeEngine, width: int) -> None:
    async with driving(engine, (width, 30)) as driver:
        await driver.run()
        seen = engine.steps[0]
        engine.do_step(Step.TOUCH)
        long = "denied by the referee: the robot's arm was pushed, as the video shows"
        denied = Ruling(Step.TOUCH, False, engine.now, "brushed", "Ada")
        first = replace(seen, sensors=engine.now + 122.456, referee=denied, reason=long)
        others = (replace(record, reason=long) for record in engine.steps[2:])
        done = replace(engine.steps[1], final=engine.now + 122.456, referee=denied)
        engine.steps = (first, done, *others)
        await driver.let_pass(1.0)
        rows = driver.rows()
        head = next(i for i, row in enumerate(rows) if "passage sensors" in row)
        begins = rows[head + 2].index("CCW ")
        column = [row.ljust(width)[begins - 1] for row in rows[head : head + 7]]
        assert column == [" "] * 7
        assert "123.456" in rows[head + 2]  # a number is whole or not there


async def test_a_ruled_step_tells_what_counts_the_ruling_and_what_the_sensors_say(
    running: Driver, engine: FakeEngine
) -> None:
    engine.do_step(Step.TOUCH)
    denied = Ruling(Step.TOUCH, False, engine.now, "brushed", "Ada")
    first = replace(engine.steps[0], referee=denied, final=None)
    engine.steps = (first, *engine.steps[1:])
    await running.settle()
    assert "x 1 touch the handle         no  denied (1.000)" in running.text


@SIZES
async def test_a_false_start_says_what_to_do(driver: Driver, engine: FakeEngine) -> None:
    await driver.set_up()
    await driver.press("f5")
    await driver.let_pass(1.5)
    assert "COUNTDOWN  starts in 0:04" in driver.text
    engine.false_start()
    await driver.settle()
    shown = " ".join(driver.text.split())
    assert "FALSE START: handle touched at -3.5 s: Enter, then r restarts the countdown" in shown
    assert "a accepts it" in shown
    await driver.press("enter", "r")
    assert "FALSE START" not in driver.text
    assert "starts in 0:05" in driver.text


async def test_a_question_to_the_referee_is_shown(running: Driver, engine: FakeEngine) -> None:
    engine.ask_referee = "the latch is silent: is the door locked?"
    await running.settle()
    assert "REFEREE: the latch is silent: is the door locked? (1-6 rules" in running.text


async def test_sensors_show_their_state_by_symbol_in_their_place(
    running: Driver, engine: FakeEngine
) -> None:
    engine.occupied = {(Side.CCW, 4), (Side.CW, 0), (Side.CCW, 1)}
    await running.settle()
    ccw, cw = "CCW   O   .   .   O   .", "CW    .   .   .   .   O"
    assert ccw in running.text
    assert cw in running.text
    engine.angle = 0.1
    await running.settle()
    assert "CCW   M   m   m   M   m" in running.text
    assert cw in running.text
    engine.freshness = Freshness.STALE
    await running.settle()
    assert "CCW   s   s   s   s   s" in running.text
    engine.freshness = Freshness.LOST
    await running.settle()
    assert "CW    ?   ?   ?   ?   ?" in running.text


async def test_a_value_that_is_lost_is_a_word_and_no_number(
    running: Driver, engine: FakeEngine
) -> None:
    engine.freshness = Freshness.STALE
    await running.settle()
    assert "+0.000 rad   +0.0 deg stale" in running.text
    engine.angle, engine.force, engine.freshness = None, None, Freshness.LOST
    for _ in range(3):
        await running.settle()
    assert "no angle: lost" in running.text
    assert "no force: lost" in running.text
    assert "0 of 6 fresh" in running.text
    assert "/madrob/door/angle lost" in running.text
    assert "●" not in running.text


async def test_the_panel_is_where_it_is(engine: FakeEngine) -> None:
    scales = {
        0.0: "CW -------------[●]============= CCW",
        0.029: "CW -------------[●]============= CCW",
        0.031: "CW -------------[|]●============ CCW",
        -0.031: "CW ------------●[|]============= CCW",
        1.5708: "CW -------------[|]============● CCW",
        -3.0: "CW ●------------[|]============= CCW",
    }

    async with driving(engine) as driver:
        await driver.press("enter", "f3")
        for angle, scale in scales.items():
            engine.angle = angle
            await driver.settle()
            assert scale in driver.text


async def test_the_source_cannot_be_mistaken(driver: Driver, engine: FakeEngine) -> None:
    assert driver.rows()[0].startswith(" ~~ SIMULATED nominal ~~ ")
    engine.kind, engine.label = SourceKind.ROS, "LIVE ros domain 0"
    for _ in range(4):
        await driver.settle()
    assert driver.rows()[0].startswith(" LIVE ros domain 0 ")
    assert "~" not in driver.rows()[0]


@pytest.mark.parametrize("label", ["SIMULATED nominal", f"REPLAY subject_001_{'x' * 60}"])
async def test_the_top_line_never_loses_recorder_and_clock(engine: FakeEngine, label: str) -> None:
    engine.label = label
    recorders = (
        RecorderView("recording", 1234567, 987_654_321, 1234),
        RecorderView("finished", 123456, 12_345_678),
        RecorderView("failed", 12, 4_000, 5, "disk full"),
    )

    async with driving(engine) as driver:
        assert "rec closed" in driver.rows()[0]
        for engine.recorder in recorders:
            for _ in range(4):
                await driver.settle()
            top = driver.rows()[0]
            assert label.split(maxsplit=1)[0] in top
            assert f" {format_size(engine.recorder.size)} " in top
            dropped = engine.recorder.dropped
            assert (f" {dropped} dropped" in top) is (dropped > 0)
            assert top.endswith(":20")


async def test_a_long_team_is_cut_before_what_says_that_nothing_counts(
    engine: FakeEngine,
) -> None:
    defaults = replace(DEFAULTS, team="Delft Openers with a rather long team name e.V.")
    async with driving(engine, defaults=defaults) as driver:
        await driver.run()
        assert "~~ SIMULATED nominal ~~  run 1 of team 1 Delft" in driver.rows()[0]


async def test_faults_stay_until_they_are_gone(running: Driver, engine: FakeEngine) -> None:
    assert "no faults" in running.rows()[1]
    engine.faults = ("panel at -0.043 rad, against the opening side",)
    await running.let_pass(60.0)
    assert " FAULT panel at -0.043 rad, against the opening side" in running.rows()[1]
    engine.faults = tuple(f"fault number {n} of the testbed" for n in range(5))
    await running.settle()
    assert "fault number 2 of the testbed (and 2 more below)" in running.rows()[3]
    await running.press("f8")
    assert "FAULT" in running.rows()[1]
    await running.press("escape")
    engine.faults = ()
    await running.settle()
    assert "no faults" in running.rows()[1]


MANY_FAULTS = (
    "the journal cannot be written (Read-only file system): 5 lines wait for the disk of the hall",
    "the result is NOT on disk (/home/ref/madrob_runs/subject_001_cond_001_run_001): trying again",
    *(f"fault number {number} of the testbed" for number in range(12)),
)


@pytest.mark.parametrize("size", [(80, 24), (120, 36)])
async def test_the_live_pane_has_every_fault_with_all_its_words(
    running: Driver, engine: FakeEngine
) -> None:
    assert "all faults" not in running.text
    seen = [row.strip() for row in running.rows()]
    engine.faults = MANY_FAULTS
    await running.settle()
    top = " ".join(row.strip() for row in running.rows()[1:4])
    assert re.search(r"\(and \d+ more below\)", top)
    assert ": F3" not in running.text
    for _ in range(5):
        seen += [row.strip() for row in running.rows() if row.strip() not in seen]
        await running.press("pagedown")
    told = " ".join(seen)
    for fault in MANY_FAULTS:
        assert "".join(fault.split()) in "".join(told.split())
    await running.press("f2")
    await running.settle()
    assert re.search(r"\(and \d+ more: F3\)", running.text)
    await running.press("f3")
    assert "next: step 1" in running.text  # it begins at its top again
    engine.faults = ()
    await running.settle()
    assert "all faults" not in running.text


@pytest.mark.parametrize("size", [(80, 24)])
async def test_a_fault_that_is_cut_ends_with_a_word_and_says_so(
    driver: Driver, engine: FakeEngine
) -> None:
    await driver.set_up()
    first = "the journal cannot be written (Read-only file system, since 22:13): 5 lines wait"
    engine.faults = (first, "another thing is wrong with the testbed", *MANY_FAULTS)
    engine.right = RightToAct(holder="bo@tent")  # a row less for faults
    await driver.settle()
    rows = driver.rows()[2:4]
    assert rows[0].endswith("(Read-only file system, since 22:13): 5 …")
    assert rows[1].endswith("another thing is wrong with the testbed (and 14 more: F3)")
    engine.faults = (f"{'w' * 50} then the stamps are 12.345678901234567890123 s late",)
    await driver.settle()
    assert driver.rows()[2].endswith("www then the … (more: F3)")
    assert "FAULT" not in driver.rows()[3]


async def test_an_engine_that_fails_is_a_fault_and_no_crash(
    running: Driver, engine: FakeEngine
) -> None:
    engine.failure = "the engine has failed: disk full"
    await running.settle()
    assert "the engine has failed: disk full: what you see is old" in running.rows()[1]
    await running.press("i")
    assert "the engine has failed" in running.console.status
    assert not running.console.dialogs


async def test_an_engine_that_stands_still_is_called_silent(engine: FakeEngine) -> None:

    times = iter([0.0, 0.0, *[10.0] * 1000])
    async with driving(engine, monotonic=lambda: next(times)) as driver:
        await driver.settle()
        assert "the engine is silent for 10 s: what you see is old" in driver.text


async def test_a_clock_that_may_have_gone_on_unseen_is_not_shown_as_fresh(
    running: Driver, engine: FakeEngine
) -> None:
    assert "RUNNING  4:59 left of 5:00" in running.text
    engine.pulse = Pulse(core=3)
    await running.settle()
    assert "the engine has not moved for 3 s: what you see is old" in running.rows()[1]
    assert "RUNNING  as it was 3 s ago" in running.text
    assert clock_span(engine.snapshot()) == ("0:01.?", Tone.DIM)
    engine.pulse = Pulse()
    await running.settle()
    assert "RUNNING  4:59 left of 5:00" in running.text


@SIZES
async def test_a_silent_disk_is_named_with_what_still_works(
    running: Driver, engine: FakeEngine
) -> None:
    engine.pulse = Pulse(disk=7, unwritten=2)
    await running.settle()
    words = "disk silent for 7 s: nothing new starts; the clock runs, abort works"
    assert words in running.rows()[1]
    assert "RUNNING  NOT ON DISK YET" in running.text
    assert engine.act(Abort("robot unsafe")) is None
    await running.settle()
    assert "ABORTED  NOT ON DISK YET" in running.text
    assert "abort works" not in running.text
    engine.pulse = Pulse()
    await running.settle()
    assert "NOT ON DISK YET" not in running.text


async def test_the_log_shows_its_newest_lines(engine: FakeEngine) -> None:
    for number in range(50):
        engine.say(f"line {number} [bold]x[/]", Origin.SYSTEM)

    async with driving(engine) as driver:
        await driver.press("f3")
        assert "system  line 49 [bold]x[/]" in driver.text
        assert "line 40" not in driver.text


@pytest.mark.slow
async def test_no_size_of_the_terminal_breaks_the_console(engine: FakeEngine) -> None:
    engine.faults = ("a fault with some words in it",)

    async with driving(engine) as driver:
        await driver.run()
        engine.finish()
        for size in ((1, 1), (10, 4), (40, 12), (60, 18), (200, 60), SMALL):
            await driver.pilot.resize_terminal(*size)
            for key in ("f1", "f2", "f3", "n", "escape", "f4"):
                await driver.press(key)
        assert "COMPLETED" in driver.text


@SIZES
async def test_what_may_still_change_is_rough_and_marked(
    running: Driver, engine: FakeEngine
) -> None:
    for step in (Step.TOUCH, Step.UNLOCK, Step.OPEN, Step.CROSS):
        engine.do_step(step)
    engine.provisional = {"time_to_handle": 1.0, "door_occupation_time": 2.345}
    for _ in range(3):
        await running.settle()
    for words in (
        "so far",
        "✓ 3 open the door         1.000",
        "✓ 4 cross the threshold    ~1.0",
        "to handle 1.000 s occupation ~2.3 s",
    ):
        assert words in running.text
    engine.provisional_doubts = {"time_to_handle": ("the touch rests on 1 sample",)}
    for _ in range(3):
        await running.settle()
    assert "to handle 1.000 s? occupation ~2.3 s" in running.text
    engine.provisional_doubts = {}
    for step in (Step.CLOSE, Step.LOCK):
        engine.do_step(step)
    await running.finish()
    await running.press("f3")
    for _ in range(3):
        await running.settle()
    assert "✓ 4 cross the threshold   1.000" in running.text
    assert "occupation 2.345 s" in running.text
    assert "~" not in "".join(running.rows()[1:])


def drawn(evidence: EvidenceView | None, width: int = 200) -> str:
    snapshot: Snapshot = replace(FakeEngine().snapshot(), evidence=evidence)
    rows = EvidenceLine().draw_lines(snapshot, width)
    assert all(width_of(row) <= width for row in rows)
    return plain(rows).rstrip("\n")


LEFT = "/camera/left/image/compressed"
GAP = "missing from +5.6 s to +8.3 s"
ENDED = "the evidence process is started again: it was ended by SIGKILL"


@pytest.mark.parametrize(
    ("evidence", "width", "told"),
    [
        (EvidenceView(), 80, "none of its topics is there"),
        (EvidenceView(problem=ENDED), 80, ENDED),
        (EvidenceView(problem=ENDED), 40, "the evidence process is start…"),
        (EvidenceView(1, 6.1e6, room=11 * 3600.0), 80, "room for 11 h  1 topic 6.1 MB/s"),
        (
            EvidenceView(2, 12.2e6, True, 48_000_000, 11 * 3600.0, worst=f"{LEFT} 12 lost"),
            120,
            f"room for 11 h  {LEFT} 12 lost  2 topics 12.2 MB/s  48 MB recorded",
        ),
        (
            EvidenceView(9, 54.9e6, room=60.0, worst=f"{LEFT} 8 lost and 7 more"),
            80,
            f"room for 60 s  {LEFT} 8 lost and 7 more  9 top…",
        ),
        (
            EvidenceView(1, 6.1e6, room=5.0, missing=GAP, worst=f"{LEFT} 12+ lost"),
            80,
            f"{GAP}  room for 5 s  {LEFT[:24]}…",
        ),
    ],
)
def test_the_evidence_line_has_what_is_wrong_the_room_the_worst_topic_and_what_comes(
    evidence: EvidenceView, width: int, told: str
) -> None:
    assert drawn(evidence, width).startswith(f"evidence  {told}")


def test_without_evidence_there_is_no_line() -> None:
    assert drawn(None) == ""


LOOK = 0.1
"""s between two looks at the screen."""

TIMEOUT = 40.0
NARROW, WIDE = 30, 160
_INDICATORS = {
    "to handle": IndicatorName.TIME_TO_HANDLE,
    "occupation": IndicatorName.DOOR_OCCUPATION_TIME,
    "passage": IndicatorName.PASSAGE_TIME,
}
_INDICATOR = re.compile(rf"({'|'.join(_INDICATORS)}) (~?[\d.]+) s")
_STEP = re.compile(r"(\d) [a-z ]+? +(~?[\d.]+)")


@dataclass(slots=True)
class Followed:
    """One number on its way: each text that stood there, in order; empty = none did."""

    texts: list[str] = field(default_factory=list)

    def note(self, text: str) -> None:
        """It stands so now."""
        if (self.texts[-1] if self.texts else "") != text:
            self.texts.append(text)


@dataclass(frozen=True, slots=True)
class Changes:
    """Of some numbers: how many were shown, how many changed afterwards, and by how much at most.

    Attributes:
        gone: how many of the changed ones have no value in the end.
        most: s; of those that have.
    """

    shown: int = 0
    changed: int = 0
    gone: int = 0
    most: float = 0.0

    def __add__(self, other: Changes) -> Changes:
        return Changes(
            self.shown + other.shown,
            self.changed + other.changed,
            self.gone + other.gone,
            max(self.most, other.most),
        )

    def __str__(self) -> str:
        return f"{self.shown:6} {self.changed:8} {self.gone:5} {self.most:9.3f}"


def texts(lines: Iterable[Line]) -> Iterator[str]:
    for row in lines:
        yield "".join(span.text for span in row)


def shown(snapshot: Snapshot) -> dict[str, str]:
    """The times on the live screen and on the wall, as they stand there, by what they are of."""
    found: dict[str, str] = {}
    for text in texts(Provisional().draw_lines(snapshot, WIDE)):
        found |= dict(_INDICATOR.findall(text))
    settled = snapshot.result is not None
    table = step_lines(snapshot.steps, snapshot.run.start, NARROW, settled=settled)
    for text in texts(table):
        found |= {f"step {number}": time for number, time in _STEP.findall(text)}
    for cell in step_cells(snapshot):
        if cell.text.startswith("✓"):
            number, time = cell.text[1:].split()
            found[f"wall {number}"] = time
    return found


def final(result: Result) -> dict[str, str]:
    """The same in the result."""
    found = {}
    for words, name in _INDICATORS.items():
        value = result.indicators[name].value
        found[words] = "" if value is None else f"{value:.3f}"
    for text in texts(step_lines(result.steps, result.start, NARROW)):
        for number, time in _STEP.findall(text):
            found |= {f"{place} {number}": time for place in ("step", "wall")}
    return found


def follow(drive: Drive, ruleset: RulesetName, condition: Condition) -> dict[str, Followed]:
    """Let a run go on to its result and look at the screens all the while."""
    followed: dict[str, Followed] = {}
    drive.start(make_setup(condition, timeout=TIMEOUT, ruleset=ruleset))
    while drive.engine.scored is None:
        snapshot = drive.engine.snapshot()
        now = shown(snapshot)
        for name in followed.keys() | now.keys():
            followed.setdefault(name, Followed()).note(now.get(name, ""))
        for _ in range(round(LOOK / STEP)):
            drive.engine.step(STEP)
    return followed


def changes(texts: Sequence[str], end: str, *, marked: bool) -> Changes:
    """What became of what was shown with the mark, or without it, of one number."""
    told = [text for text in texts if text and text.startswith(ROUGH) is marked]
    if not told:
        return Changes()
    values = [float(text.removeprefix(ROUGH)) for text in told]
    if not end:
        return Changes(1, 1, 1)
    rounding = 0.0501 if marked else 0.0
    off = max(abs(value - float(end)) for value in values)
    return Changes(1, int(off > rounding), 0, off if off > rounding else 0.0)


def of_run(
    results: Path, scenario: Scenario, seed: int, ruleset: RulesetName, *, latch: bool
) -> tuple[Changes, Changes]:
    """Of the numbers without a mark, and of those with it, in one run."""
    drive = Drive(results, scenario, seed, latch=latch)
    followed = follow(drive, ruleset, Condition.from_number(1 + seed % 20))
    assert drive.engine.scored is not None
    end = final(drive.engine.scored.result)
    drive.engine.close()
    settled, marked = (
        sum(
            (changes(f.texts, end.get(name, ""), marked=mark) for name, f in followed.items()),
            Changes(),
        )
        for mark in (False, True)
    )
    return settled, marked


@pytest.mark.parametrize("scenario", [Scenario.NOMINAL, Scenario.BOUNCES, Scenario.TURNS_BACK])
def test_a_time_without_a_mark_is_the_one_of_the_result(scenario: Scenario, tmp_path: Path) -> None:
    settled, marked = of_run(tmp_path, scenario, 3, RulesetName.PROTOCOL, latch=False)
    assert settled.shown
    assert settled.changed == 0
    assert marked.shown or scenario is Scenario.TURNS_BACK


@pytest.mark.slow
def test_no_time_without_a_mark_changes_in_any_scenario(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """`--runs` runs of each scenario, by each ruleset in turn, every other one with a latch."""
    runs = max(1, request.config.getoption("--runs") // len(Scenario))
    rulesets = list(RulesetName)
    head = f"{'shown':>6} {'changed':>8} {'gone':>5} {'by s':>9}"
    rows = [f"{'':22}{'without a mark':>31}  {'with a mark':>31}", f"{'':22}{head}  {head}"]
    whole = [Changes(), Changes()]
    for number, scenario in enumerate(Scenario):
        total = [Changes(), Changes()]
        for seed in range(number, number + runs):
            place = tmp_path / f"{scenario}_{seed}"
            ruleset = rulesets[seed % len(rulesets)]
            found = of_run(place, scenario, seed, ruleset, latch=bool(seed // 2 % 2))
            total = [one + other for one, other in zip(total, found, strict=True)]
        whole = [one + other for one, other in zip(whole, total, strict=True)]
        rows.append(f"{scenario:22}{total[0]}  {total[1]}")
    rows.append(f"{'all':22}{whole[0]}  {whole[1]}")
    print("\n".join(["", *rows]))
    assert whole[0].shown
    assert whole[0].changed == 0
