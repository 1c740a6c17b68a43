"""What the simulated sensors read: flawless perception, then noise."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from math import cos, sin
from random import Random

from madrob_console.testbeds.simulated.geometry import DoorGeometry, Levels, MotionPlan, RobotBody
from scoring.protocol import PASSAGE_SENSORS, POST_ROLL, PassageSensor, Side, Signal, Strip

RANGE_MIN = 0.02
"""m; nearer things are too close for the simulated range finders."""
RANGE_MAX = 4.0
"""m; farther things are out of their reach."""

Reading = float | bool | tuple[float, ...]
"""rad, N, m (four ranges down from the lintel), or whether the latch is engaged."""


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """Rate (Hz), and standard deviations of stamps (s), force (N) and ranges (m).

    `handle_rest` (N) and `door_rest` (rad) are what the closed door's sensors read while nobody
    touches it, before and after the first touch.
    """

    rate: float = 50.0
    jitter: float = 0.0008
    handle_rest: tuple[float, float] = (5.9, 5.4)
    handle_noise: float = 0.02
    door_rest: tuple[float, float] = (0.0, 0.0)
    range_noise: float = 0.003
    latch: bool = False


@dataclass(frozen=True, slots=True)
class Scene:
    """The objects in the doorway at one instant; a body of None = nowhere near.

    `x` is that of its middle in the frame `madrob_door`, m; `angle` (rad) and `contact` (N) are
    positive towards CCW. `strain` is 1 in a door that nobody has touched.
    """

    body: RobotBody | None = None
    x: float = 0.0
    angle: float = 0.0
    contact: float = 0.0
    latched: bool = True
    strain: float = 1.0

    @classmethod
    def of(cls, plan: MotionPlan, time: float) -> Scene:
        """The scene of a plan at `time`, s since its start."""
        x, angle, contact = plan.robot.at(time), plan.angle(time), plan.contact(time)
        return cls(plan.body, x, angle, contact, plan.latched(time), plan.strain(time))

    def at_rest(self, readings: tuple[float, float]) -> float:
        """Between the readings of a strained and of a released door."""
        before, after = readings
        return after + (before - after) * self.strain


class SensorModel:
    """Reads a scene as the testbed's sensors would."""

    def __init__(self, geometry: DoorGeometry, settings: SensorSettings, seed: int) -> None:
        self.geometry = geometry
        self.settings = settings
        self._strips = {
            Signal.of_strip(strip): tuple(
                sorted((m for m in geometry.mounts if m.strip is strip), key=lambda m: m.element)
            )
            for strip in Strip
        }
        # One stream of noise a signal, so that no reading depends on when others were taken.
        self._noise = {signal: Random(f"{seed}/{signal.name}") for signal in Signal}

    def read(self, signal: Signal, scene: Scene) -> Reading:
        settings, gauss = self.settings, self._noise[signal].gauss
        if signal is Signal.DOOR:
            noise = gauss(0.0, self.geometry.thresholds.encoder_noise)
            return self.geometry.encode(scene.angle + scene.at_rest(settings.door_rest) + noise)
        if signal is Signal.HANDLE:
            rest = scene.at_rest(settings.handle_rest)
            return scene.contact + rest + gauss(0.0, settings.handle_noise)
        if signal is Signal.LATCH:
            return scene.latched
        return self._ranges(signal, scene)

    def _ranges(self, signal: Signal, scene: Scene) -> tuple[float, ...]:
        geometry, gauss = self.geometry, self._noise[signal].gauss
        body = scene.body
        half = geometry.half_view(body) if body else 0.0
        sine, cosine = sin(scene.angle), cos(scene.angle)
        ranges = []
        for mount in self._strips[signal]:
            height = 0.0
            if body and abs(scene.x - mount.x) < half and geometry.covers(body, mount):
                height = body.height
            if geometry.sees_panel(mount, sine, cosine):
                height = max(height, geometry.panel_height)
            distance = geometry.lintel_height - height + gauss(0.0, self.settings.range_noise)
            ranges.append(max(RANGE_MIN, distance))
        return tuple(ranges)


# Flawless sensors: states and the instants of their changes.
#
# They are worked out from the plan's functions, not from samples, and independently of the
# detector.


_MARGIN = 0.06
"""s between two events whose order matters, at least: two samples, their jitter, and more."""

_HEIGHT_MARGIN = 0.03
"""m by which a body must be taller or smaller than the limit for a robot."""


@dataclass(frozen=True, slots=True)
class Switch:
    """A two-valued function of time; `changes` are (instant, value from then on), in order."""

    initial: bool
    changes: tuple[tuple[float, bool], ...] = ()

    def at(self, time: float) -> bool:
        """The value at `time` (s), an instant of change included."""
        value = self.initial
        for change, state in self.changes:
            if change > time:
                break
            value = state
        return value

    @property
    def instants(self) -> tuple[float, ...]:
        return tuple(time for time, _ in self.changes)

    @property
    def spans(self) -> Iterator[tuple[float, float, bool]]:
        """(start, end, value) of every stretch but the first and the last."""
        return ((a, b, value) for (a, value), (b, _) in pairwise(self.changes))


@dataclass(frozen=True, slots=True)
class Perception:
    """One plan, seen by flawless sensors.

    The handle is `touched` when the force first exceeds its threshold, s. `masked` sensors are
    those that the protocol ignores; `occupied` is the state that they keep meanwhile.
    """

    touched: float | None
    door_open: Switch
    latched: Switch | None
    present: dict[PassageSensor, Switch]
    masked: dict[PassageSensor, Switch]
    occupied: dict[PassageSensor, Switch]


def switch_of(value: Callable[[float], bool], instants: Iterable[float]) -> Switch:
    times = sorted(set(instants))
    state, changes = False, []
    for time, after in pairwise([*times, *(t + 1.0 for t in times[-1:])]):
        new = value((time + after) / 2)
        if new is not state:
            state = new
            changes.append((time, state))
    return Switch(False, tuple(changes))


def observe(plan: MotionPlan, geometry: DoorGeometry) -> Perception:
    present = {sensor: _present(plan, geometry, sensor) for sensor in PASSAGE_SENSORS}
    opening = Levels(plan.opening, plan.opening_knots)
    masked = {sensor: _masked(opening, plan, geometry, sensor) for sensor in PASSAGE_SENSORS}
    return Perception(
        touched=_touched(plan, geometry.thresholds.touch_force),
        door_open=_door_open(opening, plan, geometry),
        latched=None if plan.latch is None else Switch(True, plan.latch),
        present=present,
        masked=masked,
        occupied={s: _occupied(present[s], masked[s]) for s in PASSAGE_SENSORS},
    )


def is_clear_cut(plan: MotionPlan, geometry: DoorGeometry, timeout: float | None = None) -> bool:
    """Whether samples taken 20 ms apart cannot tell another story than the plan.

    False where two events whose order matters lie too close together, or a state is too short to be
    sampled. `timeout` (s since the start) and the end of the recording after it count as events.
    """
    if abs(plan.body.height - geometry.thresholds.present_height) < _HEIGHT_MARGIN:
        return False
    seen = observe(plan, geometry)
    settle = geometry.thresholds.settle_time
    sides = [
        [t for sensor, s in seen.occupied.items() if sensor.side is side for t in s.instants]
        for side in Side
    ]
    door = list(seen.door_open.instants)
    lasting = [*seen.occupied.values(), seen.door_open]
    latched = seen.latched.instants if seen.latched else ()
    ends = [] if timeout is None else [timeout, timeout + POST_ROLL]
    touch = [] if seen.touched is None else [seen.touched]
    return (
        all(_apart(seen.present[s].instants, seen.masked[s].instants) for s in PASSAGE_SENSORS)
        and all(_unmasked_long_enough(seen, sensor) for sensor in PASSAGE_SENSORS)
        and _apart(*sides)
        and _apart(door, [*sides[0], *sides[1], *latched])
        and _apart(door, touch)
        and _apart(ends, [*sides[0], *sides[1], *door, *touch, *latched])
        and all(end - start > _MARGIN for s in lasting for start, end, _ in s.spans)
        and not any(
            abs(end - start - settle) < 2 * _MARGIN
            for start, end, is_open in seen.door_open.spans
            if not is_open
        )
    )


def _apart(one: Iterable[float], other: Iterable[float]) -> bool:
    others = list(other)
    return all(abs(a - b) > _MARGIN for a in one for b in others)


def _unmasked_long_enough(seen: Perception, sensor: PassageSensor) -> bool:
    """Whether a change that shows when a mask ends shows for longer than a sample."""
    shown = set(seen.occupied[sensor].instants)
    spans = seen.masked[sensor].spans
    return all(b - a > _MARGIN for a, b, masked in spans if not masked and a in shown)


def _touched(plan: MotionPlan, force: float) -> float | None:
    # The brake resists only a hand that holds the handle already, so the grip alone decides.
    found = Levels(plan.grip.at, plan.grip.knots).crossings(-force, force)
    return found[0] if found else None


def _door_open(opening: Levels, plan: MotionPlan, geometry: DoorGeometry) -> Switch:
    level = geometry.reading_reaches(geometry.thresholds.closed_angle)
    return switch_of(lambda time: plan.opening(time) >= level, opening.crossings(level))


def _present(plan: MotionPlan, geometry: DoorGeometry, sensor: PassageSensor) -> Switch:
    mount = geometry.mount(sensor)
    tall = plan.body.height > geometry.thresholds.present_height
    if not (tall and geometry.covers(plan.body, mount)):
        return Switch(False)
    half = geometry.half_view(plan.body)
    way = Levels(plan.robot.at, plan.robot.knots)
    instants = way.crossings(mount.x - half, mount.x + half)
    return switch_of(lambda time: abs(plan.robot.at(time) - mount.x) < half, instants)


def _masked(
    opening: Levels, plan: MotionPlan, geometry: DoorGeometry, sensor: PassageSensor
) -> Switch:
    if sensor.side is not plan.condition.opening_side:
        return Switch(False)
    start, end = geometry.mask(sensor)
    low, high = geometry.reading_exceeds(start), geometry.reading_reaches(end)
    return switch_of(lambda time: low <= plan.opening(time) < high, opening.crossings(low, high))


def _occupied(present: Switch, masked: Switch) -> Switch:
    state, changes = False, []
    for time in sorted({*present.instants, *masked.instants}):
        if not masked.at(time) and present.at(time) is not state:
            state = not state
            changes.append((time, state))
    return Switch(False, tuple(changes))
