"""Zero and scale of the handle's force, from a rest and a known weight (section 3)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scoring.protocol import ScoringError, Side

GRAVITY = 9.80665

_LEAST_FORCE_SAMPLES = 50
_LEAST_TIME = 1.0  # s

LOST_PART = 0.1
"""At most this part of the readings may be lost."""

_LARGEST_DRIFT = 0.02  # of the difference between rest and weight
_LARGEST_NOISE = 0.05


@dataclass(frozen=True, slots=True)
class SteadyForce:
    """A force that stood still for a while, in the published unit.

    `duration` is in s, `noise` the standard deviation about a line that goes `drift` in all.
    """

    name: str
    samples: int
    duration: float
    median: float
    noise: float
    drift: float

    @classmethod
    def of(cls, name: str, times: Sequence[float], values: Sequence[float]) -> SteadyForce:
        """The level of published values, NaN = no reading; `ScoringError` on too few readings."""
        time, value = np.array(times, dtype=np.float64), np.array(values, dtype=np.float64)
        read = np.isfinite(value)
        lost = len(value) - int(np.count_nonzero(read))
        if lost > LOST_PART * len(value):
            raise ScoringError(f"{name}: {lost} of {len(value)} forces are no numbers: mend that")
        time, value = time[read], value[read]
        duration = float(time[-1] - time[0]) if len(time) else 0.0
        if len(time) < _LEAST_FORCE_SAMPLES or duration < _LEAST_TIME:
            raise ScoringError(
                f"{name}: {len(time)} forces in {duration:.1f} s are too few: record at least "
                f"{_LEAST_FORCE_SAMPLES} of them in some seconds"
            )
        since = time - time.mean()
        slope = float(since @ value / (since @ since))
        noise = float(np.std(value - slope * since))
        return cls(name, len(time), duration, float(np.median(value)), noise, slope * duration)


@dataclass(frozen=True, slots=True)
class HandleProposal:
    """Newtons are `published * scale + offset`; `zero` is published at rest."""

    scale: float
    zero: float
    rest: SteadyForce
    weight: SteadyForce

    @property
    def offset(self) -> float:
        """N to be added after scaling, so that the rest is 0."""
        return -self.zero * self.scale


def propose_handle(
    rest: SteadyForce, weight: SteadyForce, mass: float, towards: Side
) -> HandleProposal:
    """Zero and scale from a weight of `mass` kg.

    Raises:
        ScoringError: the mass is none, the force is not steady, or the weight hardly shows.
    """
    if not 0 < mass < math.inf:
        raise ScoringError(f"a mass of {mass:g} kg: give the weight's mass, more than 0")
    difference = weight.median - rest.median
    if difference == 0:
        raise ScoringError("rest and weight read the same: check the load cell and its topic")
    for level in sorted((rest, weight), key=lambda level: -level.noise):
        _check_steady(level, abs(difference))
    scale = towards.sign * mass * GRAVITY / difference
    if not math.isfinite(scale) or scale == 0:
        raise ScoringError(f"a mass of {mass:g} kg gives no scale: correct it")
    return HandleProposal(scale, rest.median, rest, weight)


def _check_steady(level: SteadyForce, difference: float) -> None:
    if level.noise > _LARGEST_NOISE * difference:
        raise ScoringError(
            f"{level.name}: a noise of {level.noise:.3g} is too much for a difference of "
            f"{difference:.3g} between rest and weight: keep it still, or take a heavier weight"
        )
    if abs(level.drift) > _LARGEST_DRIFT * difference:
        raise ScoringError(
            f"{level.name}: a drift of {level.drift:+.3g} in {level.duration:.1f} s is too much "
            f"for a difference of {difference:.3g} between rest and weight: wait until it is steady"
        )
