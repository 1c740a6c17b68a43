from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scoring.calibration.handle_scale import GRAVITY, SteadyForce, propose_handle
from scoring.calibration.masks import (
    LEAST_SWEEP,
    MaskProposal,
    Numbers,
    Sweep,
    SweepLog,
    Swept,
    propose_masks,
)
from scoring.protocol import PASSAGE_SENSORS, PassageSensor, ScoringError, Side, Strip, Thresholds
from scoring.samples import DoorSample, PassageSample

FLOOR, PANEL = 2.3, 0.35
STEP = 0.004
DOOR = np.concatenate([np.arange(-1.2, 1.2, STEP), np.arange(1.2, -1.2, -STEP)])
SEEN = {
    sensor: (0.09 + 0.02 * sensor.index, 0.25 + 0.1 * sensor.index) for sensor in PASSAGE_SENSORS
}
FIRST = PASSAGE_SENSORS[0]

Spoil = Callable[[Numbers, Numbers], Numbers]
"""(angle on the sensor's side, distance) -> other distances."""


def swept(
    sensor: PassageSensor,
    seen: tuple[float, float] | None,
    spoil: Spoil | None = None,
    door: Numbers = DOOR,
) -> Swept:
    """What a sensor reads that sees the panel between two angles."""
    angle = sensor.side.sign * door
    under = (angle > seen[0]) & (angle < seen[1]) if seen else np.zeros_like(angle, bool)
    distance = np.where(under, PANEL, FLOOR)
    return Swept(angle, distance if spoil is None else spoil(angle, distance), 0)


def sweep(
    seen: Mapping[PassageSensor, tuple[float, float] | None] = SEEN,
    spoil: Spoil | None = None,
    door: Numbers = DOOR,
) -> Sweep:
    """A sweep in which `spoil` changes what the first sensor reads."""
    sensors = {s: swept(s, seen[s], spoil if s is FIRST else None, door) for s in PASSAGE_SENSORS}
    return Sweep(door, 0, sensors)


def propose(of: Sweep) -> MaskProposal:
    return propose_masks(of, Thresholds())


def test_masks_begin_at_half_of_the_first_angle_and_end_an_eighth_after_the_last() -> None:
    found = propose(sweep())
    assert found.mask_from == pytest.approx([0.045, 0.055, 0.065, 0.075, 0.085], abs=STEP)
    ends = pytest.approx([0.28125, 0.39375, 0.50625, 0.61875, 0.73125], abs=STEP)
    assert [found.mask_to(side) for side in Side] == [ends, ends]
    assert found.swept == pytest.approx((-1.2, 1.2), abs=STEP)
    view, under = found.views[0], int(np.count_nonzero((-DOOR > 0.09) & (-DOOR < 0.25)))
    assert (view.sensor, view.readings, view.strays, view.under) == (FIRST, len(DOOR), 0, under)


def every(change: Callable[[Swept], Swept]) -> Sweep:
    """A sweep in which all sensors read something else."""
    plain = sweep()
    return replace(plain, sensors={sensor: change(s) for sensor, s in plain.sensors.items()})


def without_floor(s: Swept) -> Swept:
    return replace(s, distance=np.where(s.distance == FLOOR, math.inf, s.distance))


def glitches(*at: float) -> Spoil:
    def spoil(angle: Numbers, distance: Numbers) -> Numbers:
        changed = distance.copy()
        for place in at:
            changed[np.argmin(np.abs(angle - place))] = PANEL
        return changed

    return spoil


@pytest.mark.parametrize(
    ("spoilt", "lintel", "strays"),
    [
        (sweep, FLOOR, 0),
        (lambda: every(without_floor), None, 0),
        (lambda: sweep(spoil=lambda _, d: np.where(d == PANEL, -math.inf, d)), FLOOR, 0),  # close
        (lambda: sweep(spoil=glitches(-0.8, 0.0, 0.9)), FLOOR, 3),
        (lambda: sweep(spoil=at(0.15 - STEP / 2, 0.15 + STEP / 2, FLOOR)), FLOOR, 0),  # a hole
        (lambda: replace(sweep(), door_lost=100), FLOOR, 0),
    ],
    ids=["plain", "no floor in sight", "a panel too close", "glitches", "a hole", "few lost"],
)
def test_what_does_not_concern_the_panel_changes_no_mask(
    spoilt: Callable[[], Sweep], lintel: float | None, strays: int
) -> None:
    found, plain = propose(spoilt()), propose(sweep())
    assert (found.lintel_height, found.views[0].strays) == (lintel, strays)
    assert lintel is None or found.panel_height == pytest.approx(FLOOR - PANEL)
    assert found.mask_from == plain.mask_from
    assert [found.mask_to(side) for side in Side] == [plain.mask_to(side) for side in Side]


def test_the_side_that_sees_the_panel_first_sets_the_beginning_of_both() -> None:
    found = propose(sweep({**SEEN, FIRST: (0.2, 0.25)}))
    assert found.mask_from[0] == pytest.approx(0.045, abs=STEP)


def test_a_sensor_that_never_sees_the_panel_gets_no_mask() -> None:
    found = propose(sweep({**SEEN, FIRST: None}))
    assert found.views[0].first is None
    assert (found.mask_to(Side.CW)[0], found.mask_to(Side.CCW)[0] > 0.0) == (0.0, True)
    masks = propose(sweep({**SEEN, FIRST: None, PASSAGE_SENSORS[5]: None}))
    assert masks.mask_from[0] == masks.mask_to(Side.CCW)[0] == 0.0


def at(low: float, high: float, distance: float) -> Spoil:
    return lambda angle, d: np.where((angle > low) & (angle < high), distance, d)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            at(0.8, 0.9, 1.1),
            r"between -0.09 and -0.25 rad and \d+ times at about -0.85.* nobody near",
        ),
        (at(-0.9, -0.8, 1.1), "times at about 0.85 rad, which is no panel"),
        (at(-0.02, 0.02, 1.1), r"times at about -?0.0\d rad, which is no panel"),
        (at(0.09, 0.25, 1.1), r"1.20 m high at the panel's place, which is 1.95 m.*nobody near"),
        (at(-2.0, 2.0, 1.1), r"reads 1.10 m with the panel elsewhere and not 2.30 m"),
        (at(-2.0, 0.05, -math.inf), r"reads -inf m with the panel elsewhere"),
        (at(0.14, 0.16, FLOOR), r"saw the panel \d+ times .*times nothing"),
    ],
)
def test_somebody_near_is_noticed(spoil: Spoil, words: str) -> None:
    with pytest.raises(ScoringError, match=rf"^cw 0 \(cw_right\[3\]\) .*{words}"):
        propose(sweep(spoil=spoil))


def with_first(**changes: Any) -> Sweep:  # noqa: ANN401
    plain = sweep()
    first = replace(plain.sensors[FIRST], **changes)
    return replace(plain, sensors={**plain.sensors, FIRST: first})


@pytest.mark.parametrize(
    ("spoilt", "words"),
    [
        *(
            (lambda s=side: sweep(door=DOOR[DOOR * s.sign < LEAST_SWEEP - 0.02]), "to both sides")
            for side in Side
        ),
        (
            lambda: sweep({**SEEN, FIRST: (0.2, 1.5)}),
            r"still saw the panel at -1\.\d+ rad.*farther",
        ),
        (
            lambda: sweep(door=np.concatenate([np.arange(-1.2, 1.2, 0.06)] * 3)),
            r"only \d+ times: sweep more slowly",
        ),
        (lambda: sweep(door=DOOR[::20]), "60 door angles are too few"),
        (
            lambda: with_first(angle=np.array([]), distance=np.array([])),
            "0 readings are too few",
        ),
        (lambda: replace(sweep(), door_lost=200), r"200 of 1400 door angles are no numbers"),
        (lambda: with_first(lost=200), r"cw 0 .*200 of 1400 samples are no reading"),
        (
            lambda: every(lambda s: replace(s, angle=-s.angle)),
            "check the sign of the door angle",
        ),
        (
            lambda: sweep(dict.fromkeys(PASSAGE_SENSORS)),
            r"no sensor saw the panel .*: check the sensors",
        ),
        (
            lambda: every(lambda s: replace(s, distance=at(0.8, 9, 1.1)(s.angle, s.distance))),
            r"\(9 more sensors are no better\)",
        ),
    ],
)
def test_a_sweep_that_tells_too_little_is_refused_with_what_to_do(
    spoilt: Callable[[], Sweep], words: str
) -> None:
    with pytest.raises(ScoringError, match=words):
        propose(spoilt())


@settings(max_examples=30)
@given(st.lists(st.tuples(st.floats(0.06, 0.4), st.floats(0.06, 0.4)), min_size=10, max_size=10))
def test_whatever_the_angles_each_mask_holds_all_that_its_sensor_sees(
    places: list[tuple[float, float]],
) -> None:
    seen = {s: (low, low + width) for s, (low, width) in zip(PASSAGE_SENSORS, places, strict=True)}
    found = propose(sweep(seen))
    for sensor, (first, last) in seen.items():
        assert found.mask_from[sensor.index] < first
        end = found.mask_to(sensor.side)[sensor.index] / 1.125
        assert last - STEP - 1e-6 < end < last + 1e-6


# ---------------------------------------------------------------- from samples


def door(time: float, angle: float) -> DoorSample:
    return DoorSample(time, time, angle)


def scan(time: float, *ranges: float, strip: Strip = Strip.CW_RIGHT) -> PassageSample:
    return PassageSample(time, time, strip, ranges, 0.02, 4.0)


def collected(*samples: DoorSample | PassageSample) -> Sweep:
    log = SweepLog(largest_gap=0.1)
    for sample in samples:
        log.feed(sample)
    return log.sweep()


FULL = (2.0, 2.0, 2.0, 2.0)


@pytest.mark.parametrize(
    ("samples", "doors", "lost", "readings"),
    [
        pytest.param(
            [
                *(door(1.00, -0.10), scan(1.01, 2.0, 2.1, 2.2, 0.05), door(1.02, -0.20)),
                door(1.04, -0.20),
            ],
            [-0.1, -0.2, -0.2],
            (0, 0),
            [(0.15, 0.05)],
            id="a reading belongs to the door angle at its own time",
        ),
        pytest.param(
            [
                *(scan(0.9, *FULL), door(1.0, 0.0), scan(1.01, *FULL), door(1.02, 0.0)),
                *(scan(1.5, *FULL), door(2.0, 1.0), scan(2.1, *FULL)),
            ],
            [0.0, 0.0, 1.0],
            (0, 0),
            [(0.0, 2.0)],
            id="none in gaps, before and after the door",
        ),
        pytest.param(
            [
                *(door(1.0, 0.0), door(1.01, math.nan), scan(1.02, 2.0, 2.0, 2.0, math.nan)),
                *(scan(1.03, 2.0, 2.0), scan(1.04, 2.0, 2.0, 2.0, 9.9)),
                *(scan(1.05, 2.0, 2.0, 2.0, math.inf), door(1.06, 0.0)),
            ],
            [0.0, 0.0],
            (1, 3),
            [(0.0, math.inf)],
            id="what is no number is counted, an infinity is a reading",
        ),
        pytest.param(
            [door(1.0, 0.1), door(1.0, 0.2), door(1.01, 0.3)],
            [0.1, 0.3],
            (0, 0),
            [],
            id="repeated stamps are dropped",
        ),
    ],
)
def test_samples_become_a_sweep(
    samples: list[DoorSample | PassageSample],
    doors: list[float],
    lost: tuple[int, int],
    readings: list[tuple[float, float]],
) -> None:
    found = collected(*samples)
    first = found.sensors[FIRST]  # cw_right[3]
    assert found.door == pytest.approx(doors)
    assert (found.door_lost, first.lost) == lost
    pairs = list(zip(first.angle, first.distance, strict=True))
    assert pairs == [pytest.approx(pair) for pair in readings]


def test_several_recordings_count_as_one() -> None:
    one = collected(door(1.0, 0.1), scan(1.01, 1, 1, 1, 1), door(1.02, 0.1), door(1.03, math.nan))
    both = Sweep.together([one, one])
    assert (len(both.door), both.door_lost, len(both.sensors[FIRST].angle)) == (4, 2, 2)


def level(value: float, *, noise: float = 0.0, drift: float = 0.0, seed: int = 0) -> SteadyForce:
    """4 s at 50 Hz around a value."""
    times = np.arange(200) / 50
    wobble = np.random.default_rng(seed).normal(0, noise, 200) if noise else np.zeros(200)
    values = value + drift * (times / times[-1] - 0.5) + wobble
    return SteadyForce.of("recording", times.tolist(), values.tolist())


def test_a_level_has_median_noise_and_drift() -> None:
    found = level(600.0, noise=2.0, drift=6.0)
    assert (found.samples, found.duration) == pytest.approx((200, 3.98))
    assert found.median == pytest.approx(600.0, abs=1.0)
    assert found.noise == pytest.approx(2.0, rel=0.2)
    assert found.drift == pytest.approx(6.0, abs=1.5)


@pytest.mark.parametrize(
    ("loaded", "towards", "per_unit"),
    [(2600.0, Side.CCW, 1), (-1400.0, Side.CCW, -1), (-1400.0, Side.CW, 1)],
)
def test_rest_reads_zero_and_the_weight_its_force(
    loaded: float, towards: Side, per_unit: int
) -> None:
    found = propose_handle(level(600.0), level(loaded), 2.0, towards)
    assert found.scale == pytest.approx(per_unit * GRAVITY / 1000)
    assert 600.0 * found.scale + found.offset == pytest.approx(0.0, abs=1e-12)
    assert abs(loaded * found.scale + found.offset) == pytest.approx(2 * GRAVITY)


@given(st.floats(-1e4, 1e4), st.floats(1e-3, 1e3), st.sampled_from([-1, 1]), st.floats(0.1, 20))
def test_whatever_the_load_cell_its_scale_and_zero_are_found(
    zero: float, per_newton: float, sign: int, mass: float
) -> None:
    loaded = zero + sign * per_newton * mass * GRAVITY
    found = propose_handle(level(zero), level(loaded), mass, Side.CCW)
    assert found.scale * sign * per_newton == pytest.approx(1.0, rel=1e-4)
    assert found.zero == pytest.approx(zero)


@pytest.mark.parametrize(
    ("rest", "weight", "mass", "words"),
    [
        (level(600.0), level(600.0), 2.0, "read the same"),
        (level(600, noise=5.0), level(640, noise=5.0), 2.0, "noise .* between rest and weight"),
        (level(600.0), level(2600.0, noise=300.0), 2.0, "noise .* keep it still"),
        (level(600.0, drift=100.0), level(2600.0), 2.0, r"drift of \+100 in 4.0 s .* steady"),
        (level(600.0), level(2600.0, drift=-100.0), 2.0, r"drift of -100 .* steady"),
        *(
            (level(0.0), level(100.0), mass, r"a mass of .* kg: give the weight's mass")
            for mass in (0.0, -1.0, math.nan, math.inf)
        ),
    ],
)
def test_an_unsteady_force_or_a_weight_that_hardly_shows_is_refused(
    rest: SteadyForce, weight: SteadyForce, mass: float, words: str
) -> None:
    with pytest.raises(ScoringError, match=words):
        propose_handle(rest, weight, mass, Side.CCW)


TIMES = [number / 50 for number in range(100)]


@pytest.mark.parametrize(
    ("times", "forces", "words"),
    [
        ([1.0, 1.01, 1.02], [5.0, 5.0, 5.0], r"^a: 3 forces in 0.0 s are too few"),
        ([], [], "0 forces"),
        (TIMES, [5.0] * 80 + [math.nan] * 20, "20 of 100 forces are no numbers"),
    ],
)
def test_too_few_samples_or_too_many_without_a_number_are_refused(
    times: list[float], forces: list[float], words: str
) -> None:
    assert SteadyForce.of("a", TIMES, [5.0] * 95 + [math.inf] * 5).samples == 95
    with pytest.raises(ScoringError, match=words):
        SteadyForce.of("a", times, forces)
