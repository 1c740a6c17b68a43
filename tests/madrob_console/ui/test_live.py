from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from madrob_console.common.names import SourceKind
from madrob_console.engine.core.state_view import NO_STEPS
from madrob_console.engine.snapshot import (
    Pulse,
    RecorderView,
    RightToAct,
    Snapshot,
)
from madrob_console.referee.acts import (
    Abort,
    AcceptFalseStart,
    AddNote,
    MarkIncident,
    RestartCountdown,
)
from madrob_console.referee.evidence import Evidence, EvidenceTopic
from madrob_console.referee.records import IncidentKind
from madrob_console.testbeds.simulated import Scenario
from madrob_console.ui.cells.digits import digit_rows
from madrob_console.ui.cells.lines import Line, Tone, plain, width_of
from madrob_console.ui.look.words import ROUGH
from madrob_console.ui.panes.gauges import SPAN, DoorGauge, HandleGauge, strip_chart
from madrob_console.ui.panes.live_pane import Provisional
from madrob_console.ui.panes.notices import EvidenceLine
from madrob_console.ui.panes.run_status import clock_span, step_lines
from madrob_console.ui.wall import step_box
from scoring.indicator_table import IndicatorName, RulesetName
from scoring.procedure import Ruling, StepRecord
from scoring.protocol import Condition, EventName, Side, Signal, Step
from scoring.result import Result
from scoring.stamps import REORDERED
from tests.madrob_console.engine.drive import STEP, Drive, make_setup
from tests.madrob_console.robots import Played, Robot
from tests.madrob_console.ui.driver import (
    DEFAULTS,
    LARGE,
    SMALL,
    Driver,
    Stories,
    Story,
    acting,
    ages,
    did_nothing,
    engine_does,
    follow,
    has,
    in_sizes,
    no,
    no_question,
    on_engine,
    opened,
    passes,
    play,
    remember,
    says,
    sets,
    types_every,
)
from tests.madrob_console.ui.inline_engine import EPOCH, HandEngine, at_rest, start

SIZES = pytest.mark.parametrize("size", [SMALL, LARGE])


async def test_no_column_touches_or_cuts_the_next(driver: Driver, engine: HandEngine) -> None:
    await driver.run()
    seen, now = engine.snapshot().steps, engine.now
    long = "denied by the referee: the robot's arm was pushed, as the video shows"
    denied = Ruling(Step.TOUCH, False, now, "brushed", "Ada")
    first = replace(seen[0], sensors=now + 122.456, referee=denied, reason=long)
    others = (replace(record, reason=long) for record in seen[2:])
    done = replace(seen[1], final=now + 122.456, referee=denied)
    engine.put(steps=(first, done, *others))
    for width in (60, 64, 70, 80, 90, 100, 110, 130, 160, 200):
        await driver.resize(width, 27)
        rows = driver.rows()
        head = next(i for i, row in enumerate(rows) if "passage sensors" in row)
        begins = rows[head + 2].index("CCW ")
        column = [row.ljust(width)[begins - 1] for row in rows[head : head + 7]]
        assert column == [" "] * 7, width
        assert "123.456" in rows[head + 2]  # a number is whole or not there


MANY_FAULTS = (
    "the journal cannot be written (Read-only file system): 5 lines wait for the disk of the hall",
    "the result is NOT on disk (/home/ref/madrob_runs/subject_001_cond_001_run_001): trying again",
    *(f"fault number {number} of the testbed" for number in range(12)),
)


@SIZES
async def test_the_live_pane_has_every_fault_with_all_its_words(driver: Driver) -> None:
    await follow(driver, [(Driver.run, no("all faults")), (has(faults=MANY_FAULTS), no(": F3"))])
    top = " ".join(row.strip() for row in driver.rows()[1:4])
    assert re.search(r"\(and \d+ more below\)", top)
    seen: list[str] = []
    for _ in range(5):
        pane = [row.strip() for row in driver.rows()[4:-2]]  # between faults, message and keys
        seen += [row for row in pane if row not in seen]
        await driver.press("pagedown")
    for fault in MANY_FAULTS:
        assert "".join(fault.split()) in "".join("".join(seen).split())
    rows: Story = [
        ("f2", lambda d: re.search(r"\(and \d+ more: F3\)", d.text)),
        ("f3", "next: step 1"),  # it begins at its top again
        (has(faults=()), no("all faults")),
    ]
    await follow(driver, rows)


def drawn(evidence: Evidence | None, width: int = 200) -> str:
    snapshot = at_rest()
    run = replace(snapshot.run, start=0.0)
    snapshot = replace(snapshot, run=run, evidence=evidence)
    rows = EvidenceLine().draw_lines(snapshot, width)
    assert all(width_of(row) <= width for row in rows)
    return plain(rows).rstrip("\n")


def test_evidence_line_has_counts_and_what_is_wrong() -> None:
    topics = {"/tf": EvidenceTopic(553), "/camera": EvidenceTopic(0, 12, 3.0)}
    evidence = Evidence(topics, "it goes on in a new bag")
    told = "2 topics, 553 messages, 12 lost  it goes on in a new bag  /camera: 12 messages lost"
    assert drawn(None) == ""
    assert drawn(evidence).startswith(f"evidence  {told}  /camera: silent since +3.0 s")
    assert drawn(evidence, 60).endswith("…")


GUTTER = re.compile(r" *[-\d.]*[┤│]")
CURVE = re.compile("[\u2801-\u28ff●]")


def chart(snapshot: Snapshot, width: int = 90, height: int = 14) -> tuple[list[str], list[str]]:
    """The cells of both plots, and the two rows of the time axis."""
    rows = [*texts(strip_chart(snapshot, width, height))]
    assert len(rows) == height
    assert {len(row) for row in rows if GUTTER.match(row)} == {width}
    return [GUTTER.sub("", row) for row in rows if GUTTER.match(row)], rows[-2:]


def moving() -> HandEngine:
    """A run goes on, in which the door swings and the handle is pulled."""
    engine = start(HandEngine(), 19.0)
    engine.move(25.0, lambda at: 0.5 + 0.4 * math.sin(at), lambda at: 9 * math.sin(6 * at))
    return engine


def test_the_course_of_the_last_20_s_is_drawn_up_to_now() -> None:
    snapshot = moving().snapshot()
    plots, (_, times) = chart(snapshot)
    drawn = {x for row in plots for x, char in enumerate(row) if CURVE.match(char)}
    columns = len(plots[0])
    assert len(drawn) >= columns * SPAN // (SPAN + 1) - 1
    assert columns - max(drawn) <= columns // (SPAN + 1) + 1
    assert snapshot.elapsed is not None
    end = math.ceil(snapshot.elapsed)
    labels = [float(label) for label in re.findall(r"([-\d.]+) s", times)]
    assert end - SPAN - 1 <= labels[0] < labels[-1] - SPAN / 2 <= end - SPAN / 2


LETTERED = {
    EventName.HANDLE_IS_TOUCHED,
    EventName.DOOR_OPENS,
    EventName.MOVES_TO_CW,
    EventName.DOOR_CLOSES,
}


def test_events_stand_as_letters_at_their_times_on_the_axis_of_both_plots() -> None:
    engine = start(HandEngine(), 19.0)
    for step in (Step.TOUCH, Step.OPEN, Step.CROSS, Step.CLOSE):
        engine.tick(3.0)
        engine.do_step(step)
    engine.tick(REORDERED)
    snapshot = engine.snapshot()
    plots, (axis, _) = chart(snapshot)
    letters = {char: x for x, char in enumerate(axis[-len(plots[0]) :]) if char.isalpha()}
    assert [*letters] == ["t", "o", "x", "c"]
    end = math.ceil(snapshot.elapsed or 0.0) + (snapshot.run.start or 0.0)
    events = [event for event in snapshot.events if event.name in LETTERED]
    for column, event in zip(letters.values(), events, strict=True):
        assert abs(column - (1 - (end - event.time) / (SPAN + 1)) * len(plots[0])) <= 1
        assert any(row[column] == "┊" for row in plots)


def test_what_was_lost_or_stale_is_a_gap_in_the_course() -> None:
    engine = moving()
    engine.put(silent=list(Signal))
    engine.move(5.0, lambda _: 0.5, lambda _: 0.0)
    lost, _ = chart(engine.snapshot())
    engine.put(silent=())
    engine.move(5.0, lambda _: 0.5, lambda _: 0.0)
    back, _ = chart(engine.snapshot())
    columns = len(lost[0])
    for rows, begin, end in ((lost, 16.2, 21.0), (back, 11.2, 15.8)):
        missing = range(math.ceil(begin / 21 * columns), math.floor(end / 21 * columns))
        assert not any(CURVE.match(row[x]) for row in rows for x in missing)
    assert CURVE.search("".join(row[-columns // 5 :] for row in back))


def test_the_thresholds_in_use_are_drawn() -> None:
    snapshot = moving().snapshot()
    snapshot = replace(snapshot, door=replace(snapshot.door, closed_angle=0.3))
    snapshot = replace(snapshot, handle=replace(snapshot.handle, touch_force=4.0))
    text = "\n".join(texts(strip_chart(snapshot, 100, 14)))
    assert "dotted: open at 0.3 rad" in text
    assert "dotted: touch at 4.00 N" in text
    assert sum("·" in row for row in chart(snapshot)[0]) >= 4
    assert "open at 0.3 rad" in plain(DoorGauge().draw_lines(snapshot, 39))


def test_a_small_terminal_has_the_course_of_each_in_one_row() -> None:
    engine = start(HandEngine(), 19.0)
    engine.move(10.0, lambda _: 0.0, lambda _: 0.0)
    engine.move(5.0, lambda _: 1.5, lambda _: 30.0)
    engine.put(silent=list(Signal))
    engine.tick(4.0)
    snapshot = engine.snapshot()
    for gauge in (DoorGauge, HandleGauge):
        (*_, course) = gauge().draw_lines(snapshot, 39)
        assert re.search(" ▁+[▇█]+ +$", "".join(span.text for span in course))
        assert {span.tone for span in course if {*span.text} & {*"▇█"}} == {Tone.WARN}


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
    for (name, tone), time in (step_box(snapshot, record) for record in snapshot.steps):
        if tone is Tone.LIVE:
            found[f"wall {name[0]}"] = time
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


def shown_in_run(
    results: Path, scenario: Played, seed: int, ruleset: RulesetName, *, latch: bool
) -> Counter[bool]:
    """Of how many times the screens showed another text, with the mark of one that may change.

    Each text without the mark is that of the result.
    """
    drive = Drive(results, scenario, seed, latch=latch)
    setup = make_setup(Condition.from_number(1 + seed % 20), timeout=TIMEOUT, ruleset=ruleset)
    drive.start(setup)
    seen: set[tuple[str, str]] = set()
    while drive.engine.scored is None:
        seen |= shown(drive.engine.snapshot()).items()
        for _ in range(round(LOOK / STEP)):
            drive.engine.step(STEP)
    end = final(drive.engine.scored.result)
    drive.engine.close()
    settled = {(name, text) for name, text in seen if not text.startswith(ROUGH)}
    assert settled <= end.items(), (scenario, seed, settled - end.items())
    return Counter(text.startswith(ROUGH) for _, text in seen)


@pytest.mark.parametrize(
    ("scenario", "ruleset", "latch"),
    [
        (Scenario.NOMINAL, RulesetName.PROTOCOL, False),
        (Robot.BOUNCES, RulesetName.EUROBENCH_2020, True),
        (Robot.TURNS_BACK, RulesetName.EUROBENCH_2020, False),
    ],
)
def test_a_time_without_a_mark_is_the_one_of_the_result(
    scenario: Played, ruleset: RulesetName, latch: bool, tmp_path: Path
) -> None:
    found = shown_in_run(tmp_path, scenario, 3, ruleset, latch=latch)
    assert found[False]
    assert found[True] or scenario is Robot.TURNS_BACK


CLOCK = [f"{left}{right}" for left, right in zip(*map(digit_rows, ("1:04", ".0")), strict=True)]
RECORDING = RecorderView("recording", 1234567, 987_654_321, 1234)
FAILED = RecorderView("failed", 12, 4_000, 5, "disk full")
LONG_FAULT = "the journal cannot be written (Read-only file system, since 22:13): 5 lines wait"


DENIED = replace(
    StepRecord(Step.TOUCH, Step.TOUCH.text, EPOCH + 6.0, None, None),
    referee=Ruling(Step.TOUCH, False, EPOCH + 6.0, "brushed", "Ada"),
)


def top_line(label: str, *words: str) -> Callable[[Driver], object]:
    """Which source it is, what is recorded, and the time of day."""
    seen = (label.split(maxsplit=1)[0], *words)
    return lambda driver: (
        all(word in driver.rows()[0] for word in seen) and driver.rows()[0].endswith(":20")
    )


def row_ends(number: int, words: str) -> Callable[[Driver], object]:
    return lambda driver: driver.rows()[number].endswith(words)


HELD: Story = [
    (Driver.set_up,),
    ("f5",),
    (passes(1.5),),
    (engine_does(HandEngine.touch),),
    (Driver.settle, "The countdown is held"),
]
"""Somebody touched the handle in the countdown, and the question has come."""

STORIES: Stories = {
    "the clock reads the time in large digits": [
        (Driver.run,),
        (passes(63.0), lambda d: [row[8:24] for row in d.rows()[2:5]] == CLOCK),
    ],
    "a ruled step tells what counts the ruling and what the sensors say": [
        (Driver.run,),
        (has(steps=(DENIED, *NO_STEPS[1:])), "x 1 touch the handle         no  denied (1.000)"),
    ],
    "sensors show their state by symbol in their place": [
        (Driver.run,),
        (
            has(occupied={(Side.CCW, 4), (Side.CW, 0), (Side.CCW, 1)}),
            "CCW   O   .   .   O   .",
            "CW    .   .   .   .   O",
        ),
        (has(angle=0.1), "CCW   M   m   m   M   m", "CW    .   .   .   .   O"),
        (sets(silent=list(Signal)),),
        (passes(1.0), "CCW   s   s   s   s   s"),
        (passes(2.0), "CW    ?   ?   ?   ?   ?"),
    ],
    **{
        f"the top line never loses recorder and clock: {label[:9]}": [
            (on_engine(label=label), lambda d: "not recording" in d.rows()[0]),
            (has(recorder=RECORDING), top_line(label, " 988 MB ", " 1234 dropped")),
            (has(recorder=RecorderView("finished", 9, 12_345_678)), top_line(label, " 12.3 MB ")),
            ("", lambda d: "dropped" not in d.rows()[0]),
            (has(recorder=FAILED), top_line(label, " 4.0 kB ", " 5 dropped")),
        ]
        for label in ("SIMULATED nominal", f"REPLAY subject_001_{'x' * 60}")
    },
    "a fault that is cut ends with a word and says so": [
        (Driver.set_up,),
        (
            has(
                faults=(LONG_FAULT, "another thing is wrong with the testbed", *MANY_FAULTS),
                right=RightToAct(holder="bo@tent"),  # a row less for faults
            ),
            row_ends(2, "(Read-only file system, since 22:13): 5 …"),
            row_ends(3, "another thing is wrong with the testbed (and 14 more: F3)"),
        ),
        (
            has(faults=(f"{'w' * 50} then the stamps are 12.345678901234567890123 s late",)),
            row_ends(2, "www then the … (more: F3)"),
            lambda d: "FAULT" not in d.rows()[3],
        ),
    ],
    "the log shows its newest lines": [
        (Driver.run,),
        *(
            (engine_does(HandEngine.act, AddNote(f"line {number} [bold]x[/]")),)
            for number in range(50)
        ),
        (Driver.look_thrice, "referee note: line 49 [bold]x[/]", no("line 30 ")),
    ],
    "an engine that stands still is called silent": [
        (ages(10.0), "the engine is silent for 10 s"),
    ],
    "the live pane shows the whole run": [
        (in_sizes(SMALL, LARGE),),
        (Driver.run,),
        (acting(Driver.do_steps, Step.TOUCH),),
        (passes(1.25),),
        (acting(Driver.do_steps, Step.OPEN),),
        (passes(REORDERED),),
        (sets(angle=0.31, force=12.3),),
        (
            Driver.look_thrice,
            "RUNNING  4:58 left of 5:00",
            "run 1 of subject 1 Door Bots",
            "condition 1: pull, from CCW to CW, No Force",
            "next: step 4 cross the threshold",
            "✓ 1 touch the handle      1.000",
            "✓ 3 open the door         2.251",
            "> 4 cross the threshold      no",
            "  6 lock the door            no",
            "door +0.310 rad  +17.8 deg open",
            "handle raw +12.30 max 12.3 zero +0.0 N",
            "touch at 1.96 N",
            "so far  to handle 1.000 s occupation - passage -  all sensors live",
            "   +2.25 sensor  door opens",
            # the reason of a step that is not done may be
            lambda d: not [row for row in d.rows()[1:] if "…" in row and "    no  " not in row],
        ),
    ],
    "a false start says what to do": [
        (Driver.set_up,),
        ("f5",),
        (passes(1.5), "COUNTDOWN  starts in 0:04"),
        (engine_does(HandEngine.touch),),
        (
            Driver.settle,
            "HELD  3.5 s before the start",
            "FALSE START: handle touched. The countdown is held 3.5 s before the start.",
            "F8 aborts the run.",
        ),
        (passes(60.0), "HELD  3.5 s before the start"),
        ("r", RestartCountdown(), no("FALSE START: handle touched."), "starts in 0:05"),
    ],
    "a false start is accepted and the countdown goes on from where it was held": [
        *HELD,
        (passes(60.0),),
        ("a 1", AcceptFalseStart("nothing gained"), "starts in 0:04"),
    ],
    "keys typed before a false start was seen do not decide it": [
        (Driver.set_up,),
        ("f5",),
        (remember,),
        (passes(1.0),),
        (engine_does(HandEngine.touch),),
        (Driver.settle, "The countdown is held"),
        (types_every(0.0),),
        ("r", "'r' is left out: the question has just come", did_nothing),
        (types_every(1.0),),
        ("enter", "Press the key of an answer", did_nothing),
    ],
    "a false start whose question was closed is still held and says how to decide": [
        *HELD,
        ("escape", no_question),
        (passes(60.0), no_question, "at -3.5 s: r restarts, a accepts it"),
        ("enter a 1", AcceptFalseStart("nothing gained")),
    ],
    "a false start waits until the open question is answered": [
        (Driver.set_up,),
        ("f5",),
        ("i",),
        (passes(1.0),),
        (engine_does(HandEngine.touch),),
        (Driver.settle, "HELD", no("The countdown is held")),
        ("f", MarkIncident(IncidentKind.FALL)),
        (Driver.settle, "The countdown is held"),
    ],
    "who takes over the right to act is asked about a false start": [
        (Driver.set_up,),
        ("f5",),
        (has(right=RightToAct(holder="Ada@hall")),),
        (passes(1.0),),
        (engine_does(HandEngine.touch),),
        (Driver.settle, "HELD", no("The countdown is held")),
        (has(right=RightToAct()),),
        (Driver.settle, "The countdown is held"),
    ],
    "a question to the referee is shown": [
        (Driver.run,),
        (
            has(ask_referee="the latch is silent: is the door locked?"),
            "REFEREE: the latch is silent: is the door locked? (1-6 rules",
        ),
    ],
    "a value that is lost is a word and no number": [
        (Driver.run,),
        (sets(silent=list(Signal)),),
        (passes(1.0), "no angle: stale"),
        (passes(2.0),),
        (
            Driver.look_thrice,
            "no angle: lost",
            "no force: lost",
            "6 of 6 sensor topics silent",
            no("●"),
        ),
    ],
    "the source cannot be mistaken": [
        ("", lambda d: d.rows()[0].startswith(" ~~ SIMULATED nominal ~~ ")),
        (sets(kind=SourceKind.ROS, label="LIVE ros domain 0"),),
        (
            Driver.look_thrice,
            lambda d: d.rows()[0].startswith(" LIVE ros domain 0 "),
            lambda d: "~" not in d.rows()[0],
        ),
    ],
    "a long team is cut before what says that nothing counts": [
        (
            opened(
                defaults=replace(DEFAULTS, team="Delft Openers with a rather long team name e.V.")
            ),
        ),
        (Driver.run, lambda d: "~~ SIMULATED nominal ~~  run 1 of team 1 Delft" in d.rows()[0]),
    ],
    "faults stay until they are gone": [
        (Driver.run, lambda d: "no faults" in d.rows()[1]),
        (sets(faults=("panel at -0.043 rad, against the opening side",)),),
        (
            passes(60.0),
            lambda d: " FAULT panel at -0.043 rad, against the opening side" in d.rows()[1],
        ),
        (
            has(faults=tuple(f"fault number {n} of the testbed" for n in range(5))),
            lambda d: "fault number 2 of the testbed (and 2 more below)" in d.rows()[3],
        ),
        ("f8", lambda d: "FAULT" in d.rows()[1]),
        ("escape",),
        (has(faults=()), lambda d: "no faults" in d.rows()[1]),
    ],
    "an engine that fails is a fault and no crash": [
        (Driver.run,),
        (
            has(failure="the engine has failed: disk full"),
            lambda d: "the engine has failed: disk full" in d.rows()[1],
        ),
        ("i", says("the engine has failed"), no_question),
    ],
    "a clock that may have gone on unseen is not shown as fresh": [
        (Driver.run, "RUNNING  4:59 left of 5:00"),
        (
            has(pulse=Pulse(core=3)),
            lambda d: "the engine has not moved for 3 s" in d.rows()[1],
            "RUNNING  as it was 3 s ago",
            lambda d: clock_span(d.engine.snapshot()) == ("0:01.?", Tone.DIM),
        ),
        (has(pulse=Pulse()), "RUNNING  4:59 left of 5:00"),
    ],
    "a silent disk is named with what still works": [
        (Driver.run,),
        (
            has(pulse=Pulse(disk=7, unwritten=2)),
            lambda d: (
                "disk silent for 7 s: nothing new starts; the clock runs, abort works"
                in d.rows()[1]
            ),
            "RUNNING  NOT ON DISK YET",
            lambda d: d.engine.act(Abort("robot unsafe")) is None,
        ),
        (Driver.settle, "ABORTED  NOT ON DISK YET", no("abort works")),
        (has(pulse=Pulse()), no("NOT ON DISK YET")),
    ],
    "what may still change is rough and marked": [
        (Driver.run,),
        (acting(Driver.do_steps, Step.TOUCH),),
        (passes(1.0),),
        (acting(Driver.do_steps, Step.OPEN),),
        (passes(2.0),),
        (acting(Driver.do_steps, Step.CROSS),),
        (passes(REORDERED),),
        (sets(provisional={"time_to_handle": 1.0, "door_occupation_time": 2.345}),),
        (
            Driver.look_thrice,
            "so far",
            "✓ 3 open the door         2.001",
            "✓ 4 cross the threshold    ~4.0",
            "to handle 1.000 s occupation ~2.3 s",
        ),
        (sets(provisional_doubts={"time_to_handle": ("the touch rests on 1 sample",)}),),
        (Driver.look_thrice, "to handle 1.000 s? occupation ~2.3 s"),
        (sets(provisional_doubts={}),),
        (acting(Driver.do_steps, Step.CLOSE, Step.LOCK),),
        (Driver.finish,),
        ("f3",),
        (
            Driver.look_thrice,
            "✓ 4 cross the threshold   4.002",
            "occupation 2.345 s",
            lambda d: "~" not in "".join(d.rows()[1:]),
        ),
    ],
}


@pytest.mark.parametrize("story", STORIES)
async def test_what_keys_do_and_what_is_seen_then(story: str) -> None:
    await play(HandEngine, STORIES[story])
