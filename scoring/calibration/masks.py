"""The masks of a new testbed, from a swept door (protocol section 4).

The panel is swung through its range on both sides with nobody near. What a sensor then sees other
than the floor is the panel; its mask begins and ends well outside of that.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scoring.calibration.handle_scale import LOST_PART
from scoring.protocol import (
    PASSAGE_SENSORS,
    PassageSensor,
    ScoringError,
    Side,
    Signal,
    Strip,
    Thresholds,
)
from scoring.quality import is_reading
from scoring.samples import DoorSample, PassageSample, Sample
from scoring.stamps import StampGuard

Numbers = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Swept:
    """What one passage sensor read; the panel's angle at each reading is positive on its side, rad.

    `distance` is in m down from the lintel; +inf = nothing there, -inf = something too close.
    """

    angle: Numbers
    distance: Numbers
    lost: int


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """One or several recordings of a swept door; `door` holds every door angle, rad."""

    door: Numbers
    door_lost: int
    sensors: Mapping[PassageSensor, Swept]

    @classmethod
    def together(cls, sweeps: Iterable[Sweep]) -> Sweep:
        parts = tuple(sweeps)
        return cls(
            np.concatenate([sweep.door for sweep in parts]),
            sum(sweep.door_lost for sweep in parts),
            {
                sensor: Swept(
                    np.concatenate([sweep.sensors[sensor].angle for sweep in parts]),
                    np.concatenate([sweep.sensors[sensor].distance for sweep in parts]),
                    sum(sweep.sensors[sensor].lost for sweep in parts),
                )
                for sensor in PASSAGE_SENSORS
            },
        )


class SweepLog:
    """Collects one recording's samples, in the order of the bag; stamps must increase.

    Readings in a gap between door angles of more than `largest_gap` s are not used.
    """

    def __init__(self, largest_gap: float) -> None:
        self._largest_gap = largest_gap
        self._guards = {signal: StampGuard() for signal in Signal}
        self._door: list[tuple[float, float]] = []
        self._door_lost = 0
        self._strips: dict[Strip, list[tuple[float, tuple[float, ...]]]] = {s: [] for s in Strip}

    def feed(self, sample: Sample) -> None:
        admitted = self._guards[sample.signal].admit(sample)
        match admitted:
            case DoorSample():
                if math.isfinite(admitted.angle):
                    self._door.append((admitted.time, admitted.angle))
                else:
                    self._door_lost += 1
            case PassageSample():
                row = tuple(
                    admitted.ranges[i] if is_reading(admitted, i) else math.nan for i in range(4)
                )
                self._strips[admitted.strip].append((admitted.time, row))

    def sweep(self) -> Sweep:
        door = np.array(self._door, dtype=np.float64).reshape(-1, 2)
        sensors = {sensor: self._swept(sensor, door) for sensor in PASSAGE_SENSORS}
        return Sweep(door[:, 1], self._door_lost, sensors)

    def _swept(self, sensor: PassageSensor, door: Numbers) -> Swept:
        rows = self._strips[sensor.strip]
        time = np.array([time for time, _ in rows], dtype=np.float64)
        distance = np.array([row[sensor.element] for _, row in rows], dtype=np.float64)
        read = ~np.isnan(distance)
        angle = sensor.side.sign * _angle_at(time, door, self._largest_gap)
        used = read & ~np.isnan(angle)
        return Swept(angle[used], distance[used], int(np.count_nonzero(~read)))


def _angle_at(time: Numbers, door: Numbers, largest_gap: float) -> Numbers:
    """NaN before, after and in gaps."""
    if len(door) < 2:
        return np.full(len(time), np.nan)
    stamps, angles = door[:, 0], door[:, 1]
    after = np.clip(np.searchsorted(stamps, time), 1, len(stamps) - 1)
    outside = (time < stamps[0]) | (time > stamps[-1])
    gap = stamps[after] - stamps[after - 1] > largest_gap
    return np.where(outside | gap, np.nan, np.interp(time, stamps, angles))


_LEAST_READINGS = 10
_STRAYS = 3
_STRAY_PART = 0.005  # glitches of a sensor; a person is there for longer
_OTHER_PART = 0.1  # of the panel's readings may be holes or of another height
_EDGE = 0.03  # rad beside the panel's edge where a reading may still be of it
_COARSEST = 0.05  # rad between two readings at an edge
_SAME_HEIGHT = 0.15  # m


@dataclass(frozen=True, slots=True, eq=False)
class PanelView:
    """A sensor's readings, sorted into panel and others. Angles are positive on its side, rad.

    Attributes:
        under: readings of the panel, between the angles `first` and `last`; None = none.
        strays: readings of something elsewhere, with the median angle `stray_at`.
        holes: readings of nothing between first and last.
        coarse: the wider step of the door at the panel's edges; inf = an edge is missing.
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
        panel_angles, nothing, strays = angle[of_panel], angle[~present], angle[present & ~of_panel]
        ends = (float(panel_angles[0]), float(panel_angles[-1])) if len(panel_angles) else None
        return cls(
            sensor=sensor,
            readings=len(angle),
            under=len(panel_angles),
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
        """Why the readings are of no use; `panel` is the height by all sensors, m."""
        name, sign = sensor_name(self.sensor), self.sensor.side.sign
        if self.strays > _allowed_strays(self.readings):
            stretch = ""
            if self.first is not None and self.last is not None:
                stretch = f"between {sign * self.first:.2f} and {sign * self.last:.2f} rad and "
            return (
                f"{name} saw something with the door {stretch}{self.strays} times at about "
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


FIRST_MARGIN = 0.5
"""A mask begins at this part of the first angle at which the sensor sees the panel."""
LAST_MARGIN = 1.125
"""A mask ends at this many times the last angle."""
LEAST_SWEEP = 0.9
"""Least swing of the panel to both sides, rad: more than any mask of the protocol."""

_LEAST_SAMPLES = 100
_SAME_FLOOR = 0.1  # m

Angles = tuple[float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class MaskProposal:
    """Masks and lintel height from a sweep; heights in m, the swept door angles in rad.

    `lintel_height` is None where no sensor sees the floor, `panel_height` where the panel is too
    close to be measured.
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
    """The masks that a sweep shows; the settings' lintel height counts if no sensor sees the floor.

    Raises:
        ScoringError: the recording is of no use; the message says why and what to do.
    """
    _check_door(sweep.door, sweep.door_lost)
    _stop_at(_unread(sensor, swept) for sensor, swept in sweep.sensors.items())
    floors = {sensor: _floor(swept, thresholds) for sensor, swept in sweep.sensors.items()}
    lintels = [floor for floor in floors.values() if math.isfinite(floor)]
    lintel = float(np.median(lintels)) if lintels else None
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
    if lost > LOST_PART * (len(angles) + lost):
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
    if swept.lost > LOST_PART * count:
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
    reasons = [problem for problem in problems if problem is not None]
    if reasons:
        more = f" ({len(reasons) - 1} more sensors are no better)" if reasons[1:] else ""
        raise ScoringError(reasons[0] + more)


def _angles(values: Iterable[float]) -> Angles:
    a, b, c, d, e = (round(value, 6) for value in values)
    return a, b, c, d, e
