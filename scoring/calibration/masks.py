"""The masks of a new testbed from a recording in which its door is swept (protocol section 4).

The panel is swung through its range on both sides with nobody near. What a sensor then sees
other than the floor is the panel; its mask begins and ends well outside of that.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from scoring.calibration.panel_view import PanelView, sensor_name
from scoring.calibration.sweep import Numbers, Sweep, Swept
from scoring.errors import ScoringError
from scoring.protocol import PASSAGE_SENSORS, PassageSensor, Side, Thresholds

FIRST_MARGIN = 0.5
"""A mask begins at this part of the first angle at which the sensor sees the panel."""
LAST_MARGIN = 1.125
"""A mask ends at this many times the last angle."""
LEAST_SWEEP = 0.9
"""rad that the panel must be swung to on both sides: more than any mask of the protocol."""

_LEAST_SAMPLES = 100
_LOST_PART = 0.1
_SAME_FLOOR = 0.1  # m

Angles = tuple[float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class MaskProposal:
    """Masks and lintel height as they follow from a sweep.

    Attributes:
        views: what the ten sensors saw, by side and index.
        lintel_height: m; None where no sensor sees the floor.
        panel_height: m; None where the panel is too close to be measured.
        swept: the smallest and the largest door angle, rad.
    """

    views: tuple[PanelView, ...]
    lintel_height: float | None
    panel_height: float | None
    swept: tuple[float, float]

    @property
    def mask_from(self) -> Angles:
        """Where the masks begin, rad; one for both sides, by the one that sees the panel first."""
        pairs = zip(self._side(Side.CW), self._side(Side.CCW), strict=True)
        firsts = ([view.first for view in pair if view.first is not None] for pair in pairs)
        return _angles(FIRST_MARGIN * min(first, default=0.0) for first in firsts)

    def mask_to(self, side: Side) -> Angles:
        """Where the masks of a side end, rad; 0 = no mask, the sensor never saw the panel."""
        return _angles(LAST_MARGIN * (view.last or 0.0) for view in self._side(side))

    def _side(self, side: Side) -> list[PanelView]:
        return [view for view in self.views if view.sensor.side is side]


def propose_masks(sweep: Sweep, thresholds: Thresholds) -> MaskProposal:
    """The masks that a sweep shows.

    Args:
        sweep: the recording.
        thresholds: which angle is closed and which height is something; of the lintel height
            only where no sensor sees the floor.

    Raises:
        ScoringError: the recording is of no use; the message says why and what to do.
    """
    _check_door(sweep.door, sweep.door_lost)
    _stop_at(_unread(sensor, swept) for sensor, swept in sweep.sensors.items())
    floors = {sensor: _floor(swept, thresholds) for sensor, swept in sweep.sensors.items()}
    seen = [floor for floor in floors.values() if math.isfinite(floor)]
    lintel = float(np.median(seen)) if seen else None
    hanging = thresholds.lintel_height if lintel is None else lintel
    _stop_at(_blocked(sensor, floor, hanging) for sensor, floor in floors.items())
    views = [
        PanelView.of(sensor, sweep.sensors[sensor], hanging, thresholds)
        for sensor in PASSAGE_SENSORS
    ]
    if not any(view.under for view in views):
        strays = sum(view.strays for view in views)
        what = "the sign of the door angle" if strays else "the sensors"
        raise ScoringError(f"no sensor saw the panel on its side: check {what} and the topics")
    heights = [view.height for view in views if view.height is not None]
    panel = float(np.median(heights)) if heights else None
    _stop_at(view.problem(panel) for view in views)
    return MaskProposal(
        views=tuple(views),
        lintel_height=None if lintel is None else round(lintel, 3),
        panel_height=panel,
        swept=(float(np.min(sweep.door)), float(np.max(sweep.door))),
    )


def _check_door(angles: Numbers, lost: int) -> None:
    if lost > _LOST_PART * (len(angles) + lost):
        raise ScoringError(
            f"{lost} of {len(angles) + lost} door angles are no numbers: mend the encoder"
        )
    if len(angles) < _LEAST_SAMPLES:
        raise ScoringError(f"{len(angles)} door angles are too few: record the whole sweep")
    low, high = float(np.min(angles)), float(np.max(angles))
    if low > -LEAST_SWEEP or high < LEAST_SWEEP:
        raise ScoringError(
            f"the door was swept from {low:.2f} to {high:.2f} rad: swing it at least from "
            f"{-LEAST_SWEEP} to {LEAST_SWEEP} rad, to both sides"
        )


def _unread(sensor: PassageSensor, swept: Swept) -> str | None:
    count = len(swept.angle) + swept.lost
    if swept.lost > _LOST_PART * count:
        return f"{sensor_name(sensor)}: {swept.lost} of {count} samples are no reading: mend it"
    if len(swept.angle) < _LEAST_SAMPLES:
        return f"{sensor_name(sensor)}: {len(swept.angle)} readings are too few: record them, too"
    return None


def _floor(swept: Swept, thresholds: Thresholds) -> float:
    """The distance that a sensor reads with the panel elsewhere, m."""
    away = np.sort(swept.distance[swept.angle <= thresholds.closed_angle])
    return float(away[len(away) // 2]) if len(away) else math.inf


def _blocked(sensor: PassageSensor, floor: float, lintel: float) -> str | None:
    if floor == math.inf or abs(floor - lintel) <= _SAME_FLOOR:
        return None
    return (
        f"{sensor_name(sensor)} reads {floor:.2f} m with the panel elsewhere and not {lintel:.2f} "
        "m: clear what is under it, sweep with nobody near"
    )


def _stop_at(problems: Iterable[str | None]) -> None:
    """Raise the first problem, and tell how many sensors more have one."""
    found = [problem for problem in problems if problem is not None]
    if found:
        more = f" ({len(found) - 1} more sensors are no better)" if found[1:] else ""
        raise ScoringError(found[0] + more)


def _angles(values: Iterable[float]) -> Angles:
    a, b, c, d, e = (round(value, 6) for value in values)
    return a, b, c, d, e
