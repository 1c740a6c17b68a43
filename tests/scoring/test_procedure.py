"""The six steps and the capability level (protocol section 7)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import pytest

from scoring.assessment import Assessment
from scoring.procedure import Procedure, Ruling
from scoring.protocol import (
    LockDetection,
    Side,
    Step,
)
from scoring.samples import Sample
from tests.scoring.runs import (
    CONDITION,
    START,
    assessment,
    clear,
    door,
    handle,
    latch,
    passage_through,
    under,
)

THROUGH = passage_through()
UNTOUCHED = [s for s in THROUGH if s.signal.name != "HANDLE"]
UNDER_THE_SENSORS = [s for s in THROUGH if s.time != START + 5]
SPRUNG = [*THROUGH[:-1], door(6.5, 0.2), door(7.5, 0.2)]
TURNS_BACK: list[Sample] = [
    handle(2, 9), door(3, 0.5), under(4, Side.CCW), under(4.4, Side.CW),
    clear(5, Side.CW), clear(6, Side.CCW), door(7, 0.0), door(9, 0.0),
]  # fmt: skip
DONE = [2, 3, 3, 5, 6, 6]
REFEREE = {"lock": LockDetection.REFEREE}


def sampled(samples: Iterable[Sample]) -> list[Sample]:
    return sorted(samples, key=lambda s: s.time)


def up_to(time: float) -> list[Sample]:
    return [s for s in THROUGH if s.time <= START + time]


def ruling(step: Step, confirmed: bool | None, time: float = 20.0) -> Ruling:
    return Ruling(step, confirmed, START + time, "seen", "R. Eferee")


def done_at(procedure: Procedure) -> list[float | None]:
    return [None if s.final is None else round(s.final - START, 6) for s in procedure.steps]


def judged(samples: list[Sample], lock: LockDetection, **told: Any) -> Procedure:  # noqa: ANN401
    stop, rulings = told.get("stop"), told.get("rulings", ())
    return assessment(samples, lock=lock).procedure(
        rulings, stop=None if stop is None else START + stop
    )


def steps(words: str, samples: Iterable[Sample], done: Sequence[float], **told: Any) -> object:  # noqa: ANN401
    """A row: when the steps that count are done, s from the start; the others are not."""
    return pytest.param(list(samples), told, done, id=words)


@pytest.mark.parametrize(
    ("samples", "told", "done"),
    [
        steps("a whole run", THROUGH, DONE, stop=6),
        steps("live, crossing is when the starting side clears", THROUGH, [2, 3, 3, 4.6, 6, 6]),
        steps("the settle time is waited for", up_to(6.5), [2, 3, 3, 4.6, 6]),
        steps("sprung open within the settle time", SPRUNG, [2, 3, 3, 4.6]),
        steps(
            "sprung open and closed again",
            [*SPRUNG, door(8, 0.0), door(9, 0.0)],
            [2, 3, 3, 5, 8, 8],
            stop=8,
        ),
        steps("only in order", UNTOUCHED, [], stop=9),
        steps("opened before the touch", [door(1.0, 0.5), *THROUGH[2:4]], [2, 2, 2]),
        steps("closed again before it", [door(0.5, 0.5), door(1, 0.0), handle(2, 9)], [2]),
        steps("turns back, live", TURNS_BACK, [2, 3, 3]),
        steps("turns back, at the stop", TURNS_BACK, [2, 3, 3], stop=9),
        steps("closes under the sensors", UNDER_THE_SENSORS, [2, 3, 3, 6, 6, 6], stop=6),
        steps(
            "and leaves later",
            [*UNDER_THE_SENSORS, clear(7.5, Side.CW)],
            [2, 3, 3, 6, 6, 6],
            stop=6,
        ),
        steps("the starting side is occupied", up_to(4.5), [2, 3, 3]),
        steps("the starting side is clear", up_to(4.7), [2, 3, 3, 4.6]),
        steps(
            "somebody on the destination side before the opening",
            [under(1, Side.CW), handle(2, 9), door(3, 0.5), door(4, 0.0)],
            [2, 3, 3],
        ),
        steps(
            "a latch that never unlocked",
            sampled([*THROUGH, latch(-0.5, True), latch(7.5, True)]),
            [2],
        ),
        steps(
            "a latch decides, live",
            sampled([*THROUGH, latch(-0.5, True), latch(2.6, False), latch(7.5, True)]),
            [2, 2.6, 3, 4.6, 6, 7.5],
        ),
        steps(
            "a latch decides, at the stop",
            sampled([*THROUGH, latch(-0.5, True), latch(2.6, False), latch(7.5, True)]),
            [2, 2.6, 3, 5, 6, 7.5],
            stop=7.5,
        ),
        steps(
            "settle ignores the latch",
            sampled([*THROUGH, latch(-0.5, True)]),
            DONE,
            stop=6,
            lock=LockDetection.SETTLE,
        ),
        steps("the referee says that it is locked", THROUGH, [2, 3, 3, 4.6, 6], **REFEREE),
        steps(
            "and has said so",
            THROUGH,
            [2, 3, 3, 4.6, 6, 12],
            rulings=[ruling(Step.LOCK, True, 12.0)],
            **REFEREE,
        ),
        steps("sensor without a latch", THROUGH, [2, 3, 3, 4.6, 6], lock=LockDetection.SENSOR),
        *(
            steps(f"{step.name} denied", THROUGH, DONE[: step - 1], stop=6, rulings=[denied])
            for step, denied in ((step, ruling(step, False)) for step in Step)
        ),
        steps(
            "confirmed, later ones count at their own times",
            UNTOUCHED,
            [0, 3, 3, 5, 6, 6],
            stop=6,
            rulings=[ruling(Step.TOUCH, True)],
        ),
        steps(
            "the latest ruling counts",
            THROUGH,
            DONE,
            stop=6,
            rulings=[ruling(Step.CROSS, False, 10), ruling(Step.CROSS, True, 11)],
        ),
        steps(
            "taken back",
            THROUGH,
            DONE,
            stop=6,
            rulings=[ruling(Step.CROSS, False), ruling(Step.CROSS, None)],
        ),
        steps(
            "closing confirmed against an open door",
            [*(s for s in THROUGH if s.time < START + 6), door(9, 0.5)],
            [2, 3, 3, 4.6, 4.6],
            rulings=[ruling(Step.CLOSE, True, 8)],
        ),
        *(
            steps(f"stopped at {stop} s", sampled([*THROUGH, latch(-0.5, False)]), done, stop=stop)
            for stop, done in ((2.5, [2, 2]), (4.5, [2, 2, 3, 4.5]), (8.0, [2, 2, 3, 5, 6]))
        ),
    ],
)
def test_each_step_has_the_time_at_which_it_is_done(
    samples: list[Sample], told: dict[str, Any], done: Sequence[float]
) -> None:
    procedure = judged(samples, **{"lock": LockDetection.AUTO, **told})
    assert done_at(procedure) == [*done, *[None] * (6 - len(done))]
    assert procedure.level == len(done)
    assert procedure.completed == (START + done[5] if len(done) == 6 else None)


def test_what_hinders_a_step_is_told_and_what_the_sensors_found_is_kept() -> None:
    assert assessment(up_to(6.5)).procedure().settling
    silent = assessment(THROUGH, lock=LockDetection.SENSOR).procedure()
    assert "referee" in (silent.steps[-1].reason or "")
    denied = assessment(THROUGH).procedure([ruling(Step.CROSS, False)], stop=START + 6)
    assert all(record.sensors is not None for record in denied.steps)
    assert denied.steps[3].reason == "denied by the referee: seen"
    confirmed = assessment(UNTOUCHED).procedure([ruling(Step.TOUCH, True)], stop=START + 6)
    assert [record.sensors for record in confirmed.steps] == [None] * 6


@pytest.mark.parametrize("start_side", list(Side))
def test_sides_that_clear_at_the_same_stamp_are_judged_alike_live_and_at_the_stop(
    start_side: Side,
) -> None:
    to = start_side.opposite
    run = Assessment(replace(CONDITION, starting_side=start_side), START)
    for sample in (
        door(-1, 0.0), handle(-1, 0.0), handle(2, 10.0), door(3, 0.5), under(4, start_side),
        under(4.4, to), clear(5, start_side), clear(5, to), door(6, 0.0), door(7, 0.0),
    ):  # fmt: skip
        run.feed(sample)
    run.release(math.inf)
    assert run.procedure().completed == START + 6
    assert run.procedure(stop=START + 6).level == 6
