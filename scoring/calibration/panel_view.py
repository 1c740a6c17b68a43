"""What one passage sensor sees of the panel while the door is swept, and what else."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scoring.calibration.sweep import Numbers, Swept
from scoring.protocol import PassageSensor, Thresholds

_LEAST_READINGS = 10
_STRAYS = 3
_STRAY_PART = 0.005  # glitches of a sensor; a person is there for longer
_OTHER_PART = 0.1  # of the panel's readings may be holes or of another height
_EDGE = 0.03  # rad beside the panel's edge where a reading may still be of it
_COARSEST = 0.05  # rad between two readings at an edge
_SAME_HEIGHT = 0.15  # m


@dataclass(frozen=True, slots=True, eq=False)
class PanelView:
    """A sensor's readings, sorted into panel and others. Angles are positive on its side.

    Attributes:
        sensor: which.
        readings: how many there are in all.
        under: how many of them are of the panel.
        first, last: between which angles they lie, rad; None = it never saw the panel.
        strays: readings of something elsewhere than the panel.
        stray_at: the angle of the one in the middle, rad.
        holes: readings of nothing between first and last.
        coarse: the wider step of the door at the panel's edges, rad; inf = an edge is missing.
        heights: of what is taken for the panel, m; too close ones are left out.
    """

    sensor: PassageSensor
    readings: int
    under: int
    first: float | None
    last: float | None
    strays: int
    stray_at: float
    holes: int
    coarse: float
    heights: Numbers

    @classmethod
    def of(
        cls, sensor: PassageSensor, swept: Swept, lintel: float, thresholds: Thresholds
    ) -> PanelView:
        """Sort the readings of a sensor that hangs at `lintel`, m."""
        order = np.argsort(swept.angle, kind="stable")
        angle, height = swept.angle[order], lintel - swept.distance[order]
        present = height > thresholds.present_height
        possible = present & (angle > thresholds.closed_angle)
        low, high = _densest(angle, possible)
        of_panel = possible & (angle > low - _EDGE) & (angle < high + _EDGE)
        if np.count_nonzero(of_panel) <= _allowed_strays(len(angle)):
            of_panel = np.zeros_like(present)
        seen, nothing, strays = angle[of_panel], angle[~present], angle[present & ~of_panel]
        ends = (float(seen[0]), float(seen[-1])) if len(seen) else None
        return cls(
            sensor=sensor,
            readings=len(angle),
            under=len(seen),
            first=ends and ends[0],
            last=ends and ends[1],
            strays=len(strays),
            stray_at=float(np.median(strays)) if len(strays) else 0.0,
            holes=_between(nothing, *ends) if ends else 0,
            coarse=_step_at_edges(nothing, *ends) if ends else 0.0,
            heights=height[of_panel & np.isfinite(height)],
        )

    @property
    def height(self) -> float | None:
        """The median height of the panel, m; None where it was not seen, or is too close."""
        return float(np.median(self.heights)) if len(self.heights) else None

    def problem(self, panel: float | None) -> str | None:
        """Why the readings are of no use, in words; None = they are.

        Args:
            panel: its height as all sensors see it, m; None = not known.
        """
        name, sign = sensor_name(self.sensor), self.sensor.side.sign
        if self.strays > _allowed_strays(self.readings):
            seen = ""
            if self.first is not None and self.last is not None:
                seen = f"between {sign * self.first:.2f} and {sign * self.last:.2f} rad and "
            return (
                f"{name} saw something with the door {seen}{self.strays} times at about "
                f"{sign * self.stray_at:.2f} rad, which is no panel: sweep with nobody near"
            )
        if self.first is None or self.last is None:
            return None
        if math.isinf(self.coarse):
            return (
                f"{name} still saw the panel at {sign * self.last:.2f} rad, the largest angle: "
                "swing the door farther"
            )
        if self.under < _LEAST_READINGS or self.coarse > _COARSEST:
            return f"{name} saw the panel only {self.under} times: sweep more slowly"
        most = _OTHER_PART * self.under
        if panel is not None and _between(abs(self.heights - panel), _SAME_HEIGHT) > most:
            return (
                f"{name} saw something {self.height:.2f} m high at the panel's place, which is "
                f"{panel:.2f} m: sweep with nobody near"
            )
        if self.holes > most:
            return (
                f"{name} saw the panel {self.under} times between {sign * self.first:.2f} and "
                f"{sign * self.last:.2f} rad, and {self.holes} times nothing: check the sensor, "
                "sweep with nobody near"
            )
        return None


def sensor_name(sensor: PassageSensor) -> str:
    """A sensor in words: `cw 0 (cw_right[3])`."""
    return f"{sensor.side} {sensor.index} ({sensor.strip}[{sensor.element}])"


def _allowed_strays(readings: int) -> float:
    return max(_STRAYS, _STRAY_PART * readings)


def _densest(angle: Numbers, present: NDArray[np.bool_]) -> tuple[float, float]:
    """The stretch of sorted angles with the most readings of something, less those of nothing."""
    if not len(angle):
        return 0.0, 0.0
    total = np.concatenate([[0], np.cumsum(np.where(present, 1, -1))])
    gain = total[1:] - np.minimum.accumulate(total[:-1])
    end = int(np.argmax(gain))
    start = int(np.argmin(total[: end + 1]))
    return float(angle[start]), float(angle[end])


def _between(values: Numbers, low: float, high: float = math.inf) -> int:
    return int(np.count_nonzero((values > low) & (values < high)))


def _step_at_edges(nothing: Numbers, first: float, last: float) -> float:
    before, after = nothing[nothing <= first], nothing[nothing >= last]
    if not len(before) or not len(after):
        return math.inf
    return max(first - float(before[-1]), float(after[0]) - last)
