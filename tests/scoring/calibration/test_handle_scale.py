from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scoring.calibration.handle_scale import GRAVITY, HandleProposal, SteadyForce, propose_handle
from scoring.errors import ScoringError
from scoring.protocol import Side


def level(value: float, *, noise: float = 0.0, drift: float = 0.0, seed: int = 0) -> SteadyForce:
    """4 s at 50 Hz around a value."""
    times = np.arange(200) / 50
    wobble = np.random.default_rng(seed).normal(0, noise, 200) if noise else np.zeros(200)
    values = value + drift * (times / times[-1] - 0.5) + wobble
    return SteadyForce.of("recording", times.tolist(), values.tolist())


def propose(rest: SteadyForce, weight: SteadyForce, mass: float = 2.0) -> HandleProposal:
    return propose_handle(rest, weight, mass, Side.CCW)


def test_a_level_has_median_noise_and_drift() -> None:
    found = level(600.0, noise=2.0, drift=6.0)
    assert found.samples == 200
    assert found.duration == pytest.approx(3.98)
    assert found.median == pytest.approx(600.0, abs=1.0)
    assert found.noise == pytest.approx(2.0, rel=0.2)
    assert found.drift == pytest.approx(6.0, abs=1.5)


def test_rest_reads_zero_and_the_weight_its_force() -> None:
    found = propose(level(600.0), level(2600.0))
    assert found.scale == pytest.approx(GRAVITY / 1000)
    assert 600.0 * found.scale + found.offset == pytest.approx(0.0, abs=1e-12)
    assert 2600.0 * found.scale + found.offset == pytest.approx(2 * GRAVITY)


def test_a_reading_that_falls_when_pulled_towards_ccw_gives_a_negative_scale() -> None:
    assert propose(level(600.0), level(-1400.0)).scale == pytest.approx(-GRAVITY / 1000)
    towards_cw = propose_handle(level(600.0), level(-1400.0), 2.0, Side.CW)
    assert towards_cw.scale == pytest.approx(GRAVITY / 1000)


@given(st.floats(-1e4, 1e4), st.floats(1e-3, 1e3), st.sampled_from([-1, 1]), st.floats(0.1, 20))
def test_whatever_the_load_cell_its_scale_and_zero_are_found(
    zero: float, per_newton: float, sign: int, mass: float
) -> None:
    loaded = zero + sign * per_newton * mass * GRAVITY
    found = propose(level(zero), level(loaded), mass)
    assert found.scale * sign * per_newton == pytest.approx(1.0, rel=1e-4)
    assert found.zero == pytest.approx(zero)


@pytest.mark.parametrize(
    ("rest", "weight", "words"),
    [
        (level(600.0), level(600.0), "read the same"),
        (level(600.0, noise=5.0), level(640.0, noise=5.0), "noise .* between rest and weight"),
        (level(600.0), level(2600.0, noise=300.0), "noise .* keep it still"),
        (level(600.0, drift=100.0), level(2600.0), r"drift of \+100 in 4.0 s .* steady"),
        (level(600.0), level(2600.0, drift=-100.0), r"drift of -100 .* steady"),
    ],
)
def test_an_unsteady_force_or_a_weight_that_hardly_shows_is_refused(
    rest: SteadyForce, weight: SteadyForce, words: str
) -> None:
    with pytest.raises(ScoringError, match=words):
        propose(rest, weight)


@pytest.mark.parametrize("mass", [0.0, -1.0, math.nan, math.inf])
def test_a_mass_that_is_none_is_refused(mass: float) -> None:
    with pytest.raises(ScoringError, match=r"a mass of .* kg: give the weight's mass"):
        propose(level(0.0), level(100.0), mass)


def test_too_few_samples_or_too_many_without_a_number_are_refused() -> None:
    with pytest.raises(ScoringError, match=r"^a: 3 forces in 0.0 s are too few"):
        SteadyForce.of("a", [1.0, 1.01, 1.02], [5.0, 5.0, 5.0])
    with pytest.raises(ScoringError, match="0 forces"):
        SteadyForce.of("a", [], [])
    times = [number / 50 for number in range(100)]
    with pytest.raises(ScoringError, match="20 of 100 forces are no numbers"):
        SteadyForce.of("a", times, [5.0] * 80 + [math.nan] * 20)
    assert SteadyForce.of("a", times, [5.0] * 95 + [math.inf] * 5).samples == 95
