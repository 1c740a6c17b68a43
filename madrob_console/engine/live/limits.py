"""What counts as a healthy testbed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SensorLimits:
    """What counts as healthy.

    Attributes:
        fresh: up to this age a topic is fresh, s.
        lost: above this age it is lost, s.
        rate: the testbed's rate, Hz.
        least_rate, most_rate: healthy fractions of it.
        averaging: the handle zero is the mean over this long, s.
    """

    fresh: float = 0.5
    lost: float = 2.0
    rate: float = 50.0
    least_rate: float = 0.8
    most_rate: float = 3.0
    averaging: float = 1.0
