"""Masks and lintel of a new testbed from a swept door, and the handle's scale from a weight.

The panel is swung through its range on both sides with nobody near. What a sensor then sees other
than the floor is the panel; its mask begins and ends well outside of that (protocol section 4).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from scoring.kinematics import Array
from scoring.protocol import PASSAGE_SENSORS, PassageSensor, ScoringError, Side, Signal, Thresholds
from scoring.series import Flags, Series, Signals

GRAVITY = 9.80665

LEAST_SWEEP = 0.9
"""Least swing of the panel to both sides, rad: more than any mask of the protocol."""

_FIRST_MARGIN, _LAST_MARGIN = 0.5, 1.125  # of the first and the last angle of the panel
_FEWEST = 100  # readings of a sensor, and door angles
_LOST = 0.1  # of the readings
_STRAYS = 0.005  # of the readings: glitches; a person is there for longer
_EDGE = 0.03  # rad beside the panel's edge where a reading may still be of it
_FEWEST_FORCES = 50
_NOISE = 0.05  # of the difference between rest and weight

Angles = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class PanelView:
    """What a sensor saw of the panel: between which angles, positive on its side, rad.

    `strays` are readings of something elsewhere; without a panel `first` and `last` are None.
    """

    sensor: PassageSensor
    readings: int
    under: int
    first: float | None
    last: float | None
    strays: int

    @property
    def name(self) -> str:
        """The sensor in words: `cw 0 (cw_right[3])`."""
        sensor = self.sensor
        return f"{sensor.side} {sensor.index} ({sensor.strip}[{sensor.element}])"


@dataclass(frozen=True, slots=True)
class MaskProposal:
    """Masks and lintel height from a sweep; m, and the swept door angles, rad.

    `lintel_height` is None where no sensor sees the floor.
    """

    views: tuple[PanelView, ...]
    lintel_height: float | None
    swept: tuple[float, float]

    @property
    def mask_from(self) -> Angles:
        """The angle at which the masks begin, rad.

        One for both sides, by the one that sees the panel first.
        """
        firsts = []
        for index in range(5):
            of_index = [view.first or 0.0 for view in self.views if view.sensor.index == index]
            firsts.append(round(_FIRST_MARGIN * min(filter(None, of_index), default=0.0), 6))
        return tuple(firsts)

    def mask_to(self, side: Side) -> Angles:
        """Return where the masks of a side end, rad.

        0 = no mask, the sensor never saw the panel.
        """
        lasts = [view.last or 0.0 for view in self.views if view.sensor.side is side]
        return tuple(round(_LAST_MARGIN * last, 6) for last in lasts)


def propose_masks(recordings: Sequence[Signals], thresholds: Thresholds) -> MaskProposal:
    """Return the masks that recordings of a swept door show together.

    Raises:
        ScoringError: they are of no use; the message says why and what to do.
    """
    doors = [one[Signal.DOOR].within(thresholds.largest_angle).value for one in recordings]
    door = np.concatenate(doors)
    if door.size < _FEWEST or door.min() > -LEAST_SWEEP or door.max() < LEAST_SWEEP:
        raise ScoringError(
            f"the door was swept from {door.min(initial=0.0):.2f} to {door.max(initial=0.0):.2f} "
            f"rad: swing it at least from {-LEAST_SWEEP} to {LEAST_SWEEP} rad, to both sides"
        )
    readings = {sensor: _readings(sensor, recordings, thresholds) for sensor in PASSAGE_SENSORS}
    floors = [
        float(np.median(distance[angle <= thresholds.closed_angle]))
        for angle, distance in readings.values()
        if (angle <= thresholds.closed_angle).any()
    ]
    seen = [floor for floor in floors if math.isfinite(floor)]
    lintel = float(np.median(seen)) if seen else None
    views = tuple(
        _view(sensor, angle, (lintel or thresholds.lintel_height) - distance, thresholds)
        for sensor, (angle, distance) in readings.items()
    )
    if not any(view.under for view in views):
        raise ScoringError(
            "no sensor saw the panel on its side: check the sign of the door angle and the topics"
        )
    height = None if lintel is None else round(lintel, 3)
    return MaskProposal(views, height, (float(door.min()), float(door.max())))


def _readings(
    sensor: PassageSensor, recordings: Sequence[Signals], thresholds: Thresholds
) -> tuple[Array, Array]:
    """The door angles, positive on its side, and the distances of a sensor, by angle."""
    angles, distances, lost = [], [], 0
    for signals in recordings:
        door, strip = signals[Signal.DOOR], signals[Signal.of_strip(sensor.strip)]
        door = door.within(thresholds.largest_angle)
        distance = strip.value[:, sensor.element]
        is_read = ~np.isnan(distance) & _is_known(door, strip.time, thresholds.largest_gap)
        lost += int(np.isnan(distance).sum())
        if door.time.size:
            angle = np.interp(strip.time, door.time, door.value)
            angles.append(sensor.side.sign * angle[is_read])
            distances.append(distance[is_read])
    angle, distance = np.concatenate(angles), np.concatenate(distances)
    if angle.size < _FEWEST or lost > _LOST * (angle.size + lost):
        name = PanelView(sensor, 0, 0, None, None, 0).name
        raise ScoringError(
            f"{name}: {angle.size} readings and {lost} samples without one: mend it, record more"
        )
    order = np.argsort(angle, kind="stable")
    return angle[order], distance[order]


def _is_known(door: Series, time: Array, largest_gap: float) -> Flags:
    """Return where the door angle is known: not before, after or in gaps."""
    after = np.searchsorted(door.time, time)
    inside = (after > 0) & (after < door.time.size)
    gaps = np.diff(door.time, prepend=-np.inf, append=np.inf)
    return inside & (gaps[after] <= largest_gap)


def _view(sensor: PassageSensor, angle: Array, height: Array, thresholds: Thresholds) -> PanelView:
    """Sort readings, in the order of their angles, into panel, floor and others."""
    present = height > thresholds.present_height
    possible = present & (angle > thresholds.closed_angle)
    low, high = _densest(angle, possible)
    of_panel = possible & (angle > low - _EDGE) & (angle < high + _EDGE)
    allowed = max(3.0, _STRAYS * angle.size)
    if of_panel.sum() <= allowed:
        of_panel[:] = False
    strays = int((present & ~of_panel).sum())
    seen = angle[of_panel].tolist() or [None]
    view = PanelView(sensor, angle.size, int(of_panel.sum()), seen[0], seen[-1], strays)
    if strays > allowed:
        at = sensor.side.sign * float(np.median(angle[present & ~of_panel]))
        raise ScoringError(
            f"{view.name} saw something {strays} times at about {at:.2f} rad, which is no panel: "
            "sweep with nobody near"
        )
    if view.last is not None and not (angle[~present] > view.last).any():
        at = sensor.side.sign * view.last
        raise ScoringError(
            f"{view.name} still saw the panel at {at:.2f} rad, the largest angle: swing it farther"
        )
    return view


def _densest(angle: Array, present: Flags) -> tuple[float, float]:
    """The stretch of sorted angles with the most readings of something, less those of nothing."""
    total = np.concatenate([[0], np.cumsum(np.where(present, 1, -1))])
    gain = total[1:] - np.minimum.accumulate(total[:-1])
    end = int(np.argmax(gain))
    return float(angle[int(np.argmin(total[: end + 1]))]), float(angle[end])


@dataclass(frozen=True, slots=True)
class SteadyForce:
    """A force that stood still for a while, in the published unit; its standard deviation."""

    samples: int
    median: float
    noise: float


@dataclass(frozen=True, slots=True)
class HandleProposal:
    """Newtons are `published * scale + offset`."""

    scale: float
    rest: SteadyForce
    weight: SteadyForce

    @property
    def offset(self) -> float:
        """N to be added after scaling, so that the rest is 0."""
        return -self.rest.median * self.scale


def propose_handle(
    rest: Iterable[float], weight: Iterable[float], mass: float, towards: Side
) -> HandleProposal:
    """Return zero and scale from published values of a free handle and of a weight of `mass` kg.

    Raises:
        ScoringError: the mass is none, values are too few or unsteady, or the weight hardly shows.
    """
    if not 0 < mass < math.inf:
        raise ScoringError(f"a mass of {mass:g} kg: give the weight's mass, more than 0")
    levels = {"rest": _steady("rest", rest), "weight": _steady("weight", weight)}
    difference = levels["weight"].median - levels["rest"].median
    for name, level in sorted(levels.items(), key=lambda item: -item[1].noise):
        if level.noise > _NOISE * abs(difference) or not difference:
            raise ScoringError(
                f"{name}: a noise of {level.noise:.3g} is too much for a difference of "
                f"{abs(difference):.3g} between rest and weight: keep it still, or take a heavier "
                "weight"
            )
    return HandleProposal(towards.sign * mass * GRAVITY / difference, **levels)


def _steady(name: str, values: Iterable[float]) -> SteadyForce:
    value = np.array([*values], dtype=np.float64)
    read = value[np.isfinite(value)]
    if read.size < _FEWEST_FORCES or value.size - read.size > _LOST * value.size:
        raise ScoringError(f"{name}: {read.size} of {value.size} forces are numbers: record more")
    return SteadyForce(read.size, float(np.median(read)), float(read.std()))
