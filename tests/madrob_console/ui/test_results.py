from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import replace

import pytest

from madrob_console.engine.live.view import NO_STEPS
from madrob_console.engine.shown.snapshot import Pulse
from madrob_console.kinds import SourceKind
from madrob_console.referee.evidence_account import EvidenceAccount, RecordedTopic
from madrob_console.referee.on_record import RemovedEvidence
from madrob_console.referee.on_record import TestbedFault as Fault
from madrob_console.referee.run import Run
from madrob_console.standings.tally import Aggregate
from madrob_console.ui.cells.lines import Line, Tone
from madrob_console.ui.look.words import date_of
from madrob_console.ui.panes.quality_table import QualityTable
from madrob_console.ui.panes.result_head import ResultHead
from madrob_console.ui.panes.result_indicators import compared
from madrob_console.ui.panes.run_marks import run_marks
from scoring.indicator_table import IndicatorName
from scoring.procedure import Ruling
from scoring.protocol import Outcome, Step
from scoring.rest import RestForce
from scoring.result import Indicator
from tests.madrob_console.ui.driver import LARGE, SMALL, Driver, driving
from tests.madrob_console.ui.fake_engine import FOLDER, FakeEngine


async def finished(driver: Driver, outcome: Outcome = Outcome.COMPLETED) -> None:
    await driver.run()
    for step in Step:
        driver.engine.do_step(step)
    driver.engine.finish(outcome, "because")
    await driver.settle()


async def whole_text(driver: Driver) -> str:
    """The pane from top to bottom."""
    text = driver.text
    for _ in range(4):
        await driver.press("pagedown")
        text += driver.text
    return text


@pytest.mark.parametrize("size", [SMALL, LARGE])
def test_a_result_that_the_disk_refuses_is_called_so_wherever_it_is_met(
    engine: FakeEngine, size: tuple[int, int]
) -> None:
    async def drive() -> None:
        async with driving(engine, size) as driver:
            await driver.run()
            engine.pulse = Pulse(refused="the result is NOT on disk: Read-only file system")
            engine.finish()
            await driver.settle()
            text = " ".join(driver.text.split())
            assert "NOT ON DISK YET: only the engine has it, and goes on trying" in text
            assert "The result is NOT ON DISK yet" in driver.console.status
            assert "f finalises it" not in text
            await driver.press("f10")
            assert "only the engine has it" in " ".join(driver.text.split())
            await driver.press("escape", "f3")
            assert "NOT ON DISK YET" in driver.text
            engine.pulse = Pulse()
            await driver.press("f4")
            await driver.settle()
            assert "NOT ON DISK" not in driver.text
            assert "f finalises it" in " ".join(driver.text.split())
            engine.pulse = Pulse(waiting=1)  # an earlier run
            await driver.settle()
            assert "NOT ON DISK" not in driver.text
            await driver.press("f10")
            assert "A run is NOT ON DISK yet" in " ".join(driver.text.split())

    asyncio.run(drive())


@pytest.mark.parametrize("size", [SMALL, LARGE])
def test_a_result_is_shown_whole(engine: FakeEngine, size: tuple[int, int]) -> None:
    async def drive() -> None:
        async with driving(engine, size) as driver:
            await driver.run()
            await driver.press("i", "c", "n", *"dent", "enter")
            for step in Step:
                engine.do_step(step)
            engine.finish()
            await driver.settle()
            text = await whole_text(driver)
            for words in (
                "COMPLETED, valid (step 6 is done)",
                "run 1 of subject 1 Door Bots, condition 1: No Force, pull, from CCW to CW",
                "ruleset protocol, issue 1, not final yet: f finalises it",
                "SIMULATED: not an official result",
                "execution time *               17.4320 s",
                "smoothness of door actuation    0.0625 s^3/rad",
                "capability level                     6 steps",
                "✓ 6 lock the door         1.000  -           1.000",
                "door angle           1221  50.0    21.3    0    0.8    4.0    0     0    0",
                "incident          +1.00 s collision",
                "note              +1.00 s dent",
                f"files             {FOLDER}",
            ):
                assert words in " ".join(text.splitlines()) or words in text
            assert "…" not in text.replace(driver.rows()[0], "")

    asyncio.run(drive())


@pytest.mark.parametrize("size", [SMALL, LARGE])
def test_a_reason_stands_apart_from_the_name_of_its_indicator(
    engine: FakeEngine, size: tuple[int, int]
) -> None:
    async def drive() -> None:
        async with driving(engine, size) as driver:
            await finished(driver)
            assert engine.result is not None
            found = {name: Indicator(None, "", "it never moved") for name in IndicatorName}
            found[IndicatorName.EXECUTION_TIME] = Indicator(300.0, "s", None)
            engine.result = replace(engine.result, indicators=found)
            await driver.settle()
            assert "smoothness of door actuation none: it never moved" in driver.text
            assert "smoothness of door actuation none: " in driver.console.panes.results.copied

    asyncio.run(drive())


@pytest.mark.parametrize(("drift", "shown"), [(-5.5373, True), (0.9, False), (None, False)])
def test_a_drift_of_over_half_the_touch_threshold_stands_below_the_roughness(
    engine: FakeEngine, drift: float | None, shown: bool
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await finished(driver)
            assert engine.result is not None
            engine.result = replace(engine.result, rest=RestForce(drift=drift))
            await driver.settle()
            rows = driver.rows()
            below = next(n for n, row in enumerate(rows) if "roughness of door" in row) + 1
            assert ("at rest after, from zero       -5.54 N" in rows[below]) is shown
            assert ("at rest" in driver.text) is shown

    asyncio.run(drive())


def test_the_first_screen_shows_outcome_and_all_indicators(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await finished(driver)
            assert "COMPLETED" in driver.text
            assert "execution time" in driver.text
            assert "capability level" in driver.text

    asyncio.run(drive())


def test_a_missing_indicator_says_why(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await finished(driver, Outcome.TIMEOUT)
            assert "TIMEOUT, valid (because)" in driver.text
            reason = "passage time                 none: robot never reached the destination side"
            assert reason in driver.text

    asyncio.run(drive())


@pytest.mark.parametrize(
    ("outcome", "words"),
    [
        (Outcome.ABORTED, "ABORTED: the run is invalid (because)"),
        (Outcome.INTERRUPTED, "INTERRUPTED: the machine failed, left out of every aggregate"),
    ],
)
def test_an_outcome_that_does_not_count_says_so(
    engine: FakeEngine, outcome: Outcome, words: str
) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await finished(driver, outcome)
            assert words in driver.text

    asyncio.run(drive())


def test_a_live_result_is_not_marked_as_simulated(engine: FakeEngine) -> None:
    engine.kind, engine.label = SourceKind.ROS, "LIVE ros domain 0"

    async def drive() -> None:
        async with driving(engine) as driver:
            await finished(driver)
            assert "not an official result" not in driver.text

    asyncio.run(drive())


def test_before_a_result_the_pane_says_so(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.press("f4")
            assert "No result yet" in driver.text

    asyncio.run(drive())


def test_nothing_of_an_old_result_stays_behind_an_abort(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await finished(driver)
            await driver.press("x", "y", "f4")
            assert "No result yet" in driver.text
            assert "execution time" not in driver.text

    asyncio.run(drive())


def test_another_result_begins_at_its_top(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await finished(driver)
            await driver.press("pagedown", "pagedown")
            assert "COMPLETED" not in driver.text
            await driver.press("x", "y", "f6", "f5")
            await driver.let_pass(6.0)
            engine.finish()
            await driver.settle()
            assert "COMPLETED" in driver.text
            assert "run 2 of subject 1" in driver.text

    asyncio.run(drive())


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
    fault = Fault(engine.now, "/madrob/door/angle: lost")
    engine.run = replace(engine.run, rulings=(denial,), faults=(fault,))
    engine.finish(reason="all six steps done")
    await driver.settle()


@pytest.mark.parametrize("size", [(60, 18), SMALL, LARGE, (160, 50)])
def test_what_a_decision_hangs_on_is_seen_first(engine: FakeEngine, size: tuple[int, int]) -> None:
    async def drive() -> None:
        async with driving(engine, size) as driver:
            await with_flags(driver)
            shown = " ".join(driver.text.split())
            for words in (
                "COMPLETED, valid (3 of 6 steps count)",
                "1 false start UNDECIDED (handle touched): a accepts it with a reason",
                "step 4 denied",
                "1 testbed fault",
                "1 incident (fall)",
            ):
                assert words in shown
            assert shown.index("UNDECIDED") < shown.index("run 1 of subject 1")
            assert "all six steps done" not in shown
            await driver.press("f3")
            assert "all six steps done" not in driver.text

    asyncio.run(drive())


def test_the_live_screen_of_a_stopped_run_says_how_many_steps_count(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine, LARGE) as driver:
            await with_flags(driver)
            await driver.press("f3")
            assert "3 of 6 steps count" in driver.text

    asyncio.run(drive())


def test_a_reason_that_all_indicators_have_stands_there_once(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await finished(driver, Outcome.ABORTED)
            assert engine.result is not None
            none = {name: Indicator.missing(name, "run aborted: invalid") for name in IndicatorName}
            engine.result = replace(engine.result, indicators=none)
            await driver.settle()
            assert driver.text.count("run aborted: invalid") == 1
            assert "indicators  none: run aborted: invalid" in driver.text

    asyncio.run(drive())


def test_a_result_that_was_signed_with_something_undecided_says_so(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine, LARGE) as driver:
            await with_flags(driver)
            await driver.press("f", "y", "a", "enter")
            assert "1 false start UNDECIDED (handle touched); step 4 denied" in driver.text
            assert "acknowledged by the team, signed Ada with what is undecided" in driver.text
            assert "a accepts it" not in driver.text

    asyncio.run(drive())


def toned(driver: Driver, width: int = 78) -> dict[str, Tone]:
    """The words of the result's head, with their tones."""
    lines = ResultHead().draw(driver.engine.snapshot(), width)
    return {span.text: span.tone for row in lines for span in row}


def test_the_headline_has_the_colour_of_the_heaviest_flag(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await with_flags(driver)
            headline = "COMPLETED, valid (3 of 6 steps count)"
            assert toned(driver)[headline] is Tone.BAD
            await driver.press("a", "1")
            assert toned(driver)[headline] is Tone.WARN
            assert toned(driver)["1 false start accepted"] is Tone.DIM
            engine.run = replace(engine.run, rulings=(), incidents=(), faults=(), decided=())
            assert toned(driver)[headline] is Tone.GOOD

    asyncio.run(drive())


@pytest.mark.parametrize("size", [LARGE, (160, 50)])
def test_a_large_screen_says_why_a_step_is_not_done(
    engine: FakeEngine, size: tuple[int, int]
) -> None:
    async def drive() -> None:
        async with driving(engine, size) as driver:
            await with_flags(driver)
            assert "denied by the referee" in driver.text
            assert "comes after step 4" in driver.text
            ruling = "step 4 denied: a wheel stayed on the line all the time"
            assert ruling in driver.text  # the newest stands above the data quality

    asyncio.run(drive())


@pytest.mark.parametrize("size", [SMALL, LARGE, (116, 40), (160, 50)])
def test_a_long_reason_does_not_run_into_the_steps(
    engine: FakeEngine, size: tuple[int, int]
) -> None:
    async def drive() -> None:
        async with driving(engine, size) as driver:
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

    asyncio.run(drive())


def test_the_newest_ruling_comes_first() -> None:
    said = ("first", "second")
    rulings = tuple(Ruling(Step.CROSS, True, 5.0, words, "Ada") for words in said)
    words = [text for kind, text in run_marks(Run(rulings=rulings)) if kind == "ruling"]
    assert [text.rpartition(" ")[2] for text in words] == ["second", "first"]


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
    indicator = Indicator.of(name, value)
    earlier = Aggregate.of([10.0, 10.0])
    spans = compared(name, indicator, earlier, 2, width=75)
    assert words in " ".join("".join(span.text for span in spans).split())
    assert spans[0].tone is tone
    narrow = compared(name, indicator, earlier, 2, width=62)
    assert words in " ".join("".join(span.text for span in narrow).split())


def test_a_result_does_not_say_that_something_may_still_come(engine: FakeEngine) -> None:
    async def drive() -> None:
        async with driving(engine) as driver:
            await driver.run()
            first, *others = NO_STEPS
            engine.steps = (replace(first, reason="handle not touched yet"), *others)
            engine.finish(Outcome.TIMEOUT, "the team gives up")
            await driver.settle()
            assert "handle not touched" in driver.text
            assert "yet" not in driver.text.replace("not final yet", "")

    asyncio.run(drive())


@pytest.mark.parametrize("size", [SMALL, LARGE])
def test_evidence_that_was_removed_is_not_shown_as_if_it_were_there(
    engine: FakeEngine, size: tuple[int, int]
) -> None:
    async def drive() -> None:
        async with driving(engine, size) as driver:
            await finished(driver)
            snapshot = engine.snapshot()
            assert snapshot is not None
            topic = RecordedTopic("/cam", "sensor_msgs/msg/Image", messages=881, bytes=34_300_000)
            run = replace(snapshot.run, evidence=EvidenceAccount((topic,)))
            there = replace(snapshot, run=run)
            gone = replace(run, removed_evidence=(RemovedEvidence(1.7e9, 1, 34_300_000),))
            words = "1 topic, 881 messages, 34.3 MB"
            assert shown(QualityTable().draw(there, size[0])).endswith(words)
            told = shown(QualityTable().draw(replace(snapshot, run=gone), size[0]))
            assert " ".join(told.split()).endswith(f"{words}; removed by tidy on {date_of(1.7e9)}")

    asyncio.run(drive())


def shown(lines: Sequence[Line]) -> str:
    return "\n".join("".join(span.text for span in row) for row in lines)
