"""Masks from a swept door and a scale from a weight, whose truth is known."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np
import pytest

from scoring.calibration import GRAVITY, MaskProposal, propose_handle, propose_masks
from scoring.protocol import (
    PASSAGE_SENSORS,
    SENSORS_PER_STRIP,
    ScoringError,
    Side,
    Strip,
    Thresholds,
)
from scoring.samples import DoorSample, PassageSample, Sample
from scoring.series import signals_of

FLOOR, PANEL, STEP = 2.3, 0.35, 0.004
SWING = np.concatenate([np.arange(-1.2, 1.2, STEP), np.arange(1.2, -1.2, -STEP)])
SEEN = {s: (0.09 + 0.02 * s.index, 0.25 + 0.1 * s.index) for s in PASSAGE_SENSORS}
FIRST = PASSAGE_SENSORS[0]

Spoil = Callable[[float, float], float]
"""(angle on the sensor's side, distance) -> another distance."""


def unspoilt(_: float, distance: float) -> float:
    return distance


def swept(spoil: Spoil = unspoilt, swing: Iterable[float] = SWING) -> list[Sample]:
    """A sweep in which `spoil` changes what the first sensor reads."""
    samples: list[Sample] = []
    for number, angle in enumerate(swing):
        time = 100 + number / 50
        samples.append(DoorSample(time, time, float(angle)))
        ranges = {strip: [FLOOR] * SENSORS_PER_STRIP for strip in Strip}
        for sensor, (low, high) in SEEN.items():
            turned = sensor.side.sign * float(angle)
            distance = PANEL if low < turned < high else FLOOR
            if sensor is FIRST:
                distance = spoil(turned, distance)
            ranges[sensor.strip][sensor.element] = distance
        for strip, row in ranges.items():
            samples.append(PassageSample(time, time, strip, tuple(row), 0.0, 4.0))
    return samples


def proposed(*recordings: list[Sample]) -> MaskProposal:
    return propose_masks([signals_of(samples) for samples in recordings], Thresholds())


def test_masks_lie_well_outside_of_the_panel() -> None:
    found = proposed(swept())
    assert found.mask_from == pytest.approx([0.045, 0.055, 0.065, 0.075, 0.085], abs=STEP)
    ends = pytest.approx([0.28125, 0.39375, 0.50625, 0.61875, 0.73125], abs=STEP)
    assert [found.mask_to(side) for side in Side] == [ends, ends]
    assert found.lintel_height == FLOOR
    assert found.views[0].strays == 0


def test_a_recording_of_each_side_is_as_good() -> None:
    half = SWING[SWING < 0], SWING[SWING >= 0]
    both = proposed(swept(swing=half[0]), swept(swing=half[1]))
    assert both.mask_from == pytest.approx(proposed(swept()).mask_from, abs=STEP)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda angle, distance: PANEL if abs(angle + 0.8) < STEP / 2 else distance,
        lambda _, distance: -math.inf if distance == PANEL else distance,
        lambda angle, distance: FLOOR if abs(angle - 0.15) < STEP / 2 else distance,
    ],
    ids=["glitches", "panel too close", "holes"],
)
def test_single_readings_change_no_mask(spoil: Spoil) -> None:
    assert proposed(swept(spoil)).mask_from == proposed(swept()).mask_from


REFUSED: dict[str, tuple[list[Sample], str]] = {
    "one side": (swept(swing=SWING[SWING > -0.5]), "to both sides"),
    "nothing": ([], "to both sides"),
    "somebody near": (
        swept(lambda angle, d: 0.4 if -0.7 < angle < -0.4 else d),
        r"cw 0 \(cw_right\[3\]\) saw something .* sweep with nobody near",
    ),
    "dead sensor": (swept(lambda _, __: math.nan), r"cw 0 .*samples without one: mend it"),
    "panel to the end": (
        swept(lambda angle, d: PANEL if angle > 0.09 else d),
        "the largest angle: swing it farther",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_useless_sweep_is_refused(case: str) -> None:
    samples, words = REFUSED[case]
    with pytest.raises(ScoringError, match=words):
        proposed(samples)


def forces(level: float, noise: float = 0.5, count: int = 200) -> list[float]:
    return [*map(float, level + noise * np.random.RandomState(1).standard_normal(count))]


@pytest.mark.parametrize("towards", Side)
def test_a_weight_gives_scale_and_zero(towards: Side) -> None:
    found = propose_handle(forces(601.6), forces(5601.6), 5.0, towards)
    assert found.scale == pytest.approx(towards.sign * GRAVITY / 1000, rel=1e-3)
    assert found.offset == pytest.approx(-601.6 * found.scale, rel=1e-3)


@pytest.mark.parametrize(
    ("rest", "weight", "mass", "words"),
    [
        (forces(0), forces(5000), 0.0, "give the weight's mass"),
        (forces(0), forces(5000, noise=900), 5.0, "weight: a noise of"),
        (forces(7, noise=0), forces(7, noise=0), 5.0, "rest: a noise of 0 is too much"),
        (forces(0, count=9), forces(5000), 5.0, "rest: 9 of 9 forces are numbers: record more"),
        ([math.nan] * 99, forces(5000), 5.0, "rest: 0 of 99 forces"),
    ],
)
def test_a_useless_weight_is_refused(
    rest: list[float], weight: list[float], mass: float, words: str
) -> None:
    with pytest.raises(ScoringError, match=words):
        propose_handle(rest, weight, mass, Side.CCW)
