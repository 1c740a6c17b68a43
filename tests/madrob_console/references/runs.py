"""The reference runs: motions, forces and obstacles that formulas give.

Times are s since the start of the run, angles rad, forces N.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from scoring.protocol import PASSAGE_SENSORS, BenchmarkType, Condition, Side, Thresholds

INTERVAL = 0.02
"""s between two samples of each topic."""

COUNTS = 3600
COUNT = math.tau / COUNTS
"""One step of the encoder, rad."""

PRE_ROLL = 2.0
"""The recording begins so long before the start, s."""

PANEL_HEIGHT = 1.6
"""Of a panel that is seen, m."""

CLOSED = Thresholds().closed_angle
SETTLE = Thresholds().settle_time


@dataclass(frozen=True, slots=True)
class Stay:
    """Something stands under all sensors of a side, from `since` to `until`, `height` m high."""

    side: Side
    since: float
    until: float
    height: float = 1.5


@dataclass(frozen=True, slots=True)
class Pulse:
    """Half a sine of force on the handle: `peak` N, `duration` s from `begins` on."""

    begins: float
    duration: float
    peak: float

    def at(self, time: float) -> float:
        """The force."""
        inside = 0 < time - self.begins < self.duration
        return self.peak * math.sin(math.pi * (time - self.begins) / self.duration) * inside


@dataclass(frozen=True, slots=True)
class ReferenceRun:
    """One run.

    Attributes:
        name: of its file.
        about: what it is, in words.
        condition: of the run.
        angle: of the panel.
        length: the recording ends so long after the start, s; with the pre-roll whole seconds.
        timeout: the run ends then, s; None = it is completed by a door that stays closed.
        pulses: on the handle.
        stays: under the passage sensors.
        handle_zero: what the load cell reads at rest, and the referee has zeroed.
        panel_seen: the sensors under which the panel passes see it where all of a side are masked.
        encoder: the angle is read by an encoder of 3600 counts a turn; else it is exact.
    """

    name: str
    about: str
    condition: Condition
    length: float
    angle: Callable[[float], float] = lambda _time: 0.0
    timeout: float | None = None
    pulses: tuple[Pulse, ...] = ()
    stays: tuple[Stay, ...] = ()
    handle_zero: float = 0.0
    panel_seen: bool = False
    encoder: bool = False

    def times(self) -> list[float]:
        """When samples are taken."""
        count = round((PRE_ROLL + self.length) / INTERVAL) + 1
        return [round(k * INTERVAL - PRE_ROLL, 9) for k in range(count)]

    def read_angle(self, time: float) -> float:
        """What the encoder says; an exact one is rounded far below anything that counts."""
        angle = self.angle(time)
        return round(angle / COUNT) * COUNT if self.encoder else round(angle, 12)

    def read_force(self, time: float) -> float:
        """What the load cell says."""
        return round(self.handle_zero + sum(pulse.at(time) for pulse in self.pulses), 12)

    def height(self, side: Side, time: float) -> float:
        """Of what stands under the sensors of a side, m."""
        there = [s.height for s in self.stays if s.side is side and s.since <= time < s.until]
        if self.panel_seen and _all_masked(side, self.angle(time)):
            there.append(PANEL_HEIGHT)
        return max(there, default=0.0)

    @property
    def stop(self) -> float:
        """The end of the run: the time out, or the first sample of the door that stays closed."""
        if self.timeout is not None:
            return self.timeout
        is_open = [t for t in self.times() if abs(self.read_angle(t)) >= CLOSED]
        return round(is_open[-1] + INTERVAL, 9)


def _all_masked(side: Side, angle: float) -> bool:
    return all(Thresholds().masked(side, sensor.index, angle) for sensor in PASSAGE_SENSORS)


def minimum_jerk(part: float, *, smooth: bool = True) -> float:
    """The way gone, 0 to 1, when `part` of the time of a motion has passed."""
    x = min(1.0, max(0.0, part))
    return x**3 * (10 - 15 * x + 6 * x**2) if smooth else x


@dataclass(frozen=True, slots=True)
class Swing:
    """The door opens to `top` and closes again, each by minimum jerk, or else at constant speed."""

    opens: float
    opening: float
    closes: float
    closing: float
    top: float
    smooth: bool = True

    def __call__(self, time: float) -> float:
        """The angle."""
        up = minimum_jerk((time - self.opens) / self.opening, smooth=self.smooth)
        down = minimum_jerk((time - self.closes) / self.closing, smooth=self.smooth)
        return self.top * (up - down)


@dataclass(frozen=True, slots=True)
class Tremor:
    """The door swings by a sine about an angle; both grow, stay and go by minimum jerk."""

    begins: float
    growing: float
    staying: float
    middle: float
    amplitude: float
    frequency: float

    def __call__(self, time: float) -> float:
        """The angle."""
        goes = self.begins + self.growing + self.staying
        size = minimum_jerk((time - self.begins) / self.growing)
        size -= minimum_jerk((time - goes) / self.growing)
        sine = math.sin(math.tau * self.frequency * (time - self.begins))
        return size * (self.middle + self.amplitude * sine)


def _condition(opening: Side, starting: Side) -> Condition:
    return Condition(BenchmarkType.NO_FORCE, opening, starting)


PUSH_TO_CCW = _condition(Side.CCW, Side.CW)
PUSH_TO_CW = _condition(Side.CW, Side.CCW)
PULL_TO_CCW = _condition(Side.CCW, Side.CCW)
PULL_TO_CW = _condition(Side.CW, Side.CW)

_SMOOTH = ReferenceRun(
    "minimum_jerk",
    "the door opens to 1 rad in 2.4 s and closes in 2 s by minimum jerk; pushed from CW",
    PUSH_TO_CCW,
    9.0,
    Swing(1.6, 2.4, 4.6, 2.0, 1.0),
    pulses=(Pulse(1.513, 0.6, 30.0),),
    stays=(Stay(Side.CW, 1.013, 4.293), Stay(Side.CCW, 4.107, 4.513)),
)
_TREMOR = ReferenceRun(
    "sine",
    "the door swings by 0.1 rad at 1.6 Hz about 0.2 rad; nobody touches it",
    PULL_TO_CCW,
    11.0,
    Tremor(0.5, 2.0, 2.0, 0.2, 0.1, 1.6),
    timeout=8.0,
)
_RAMP = ReferenceRun(
    "constant_speed",
    "the door opens to 0.8 rad and closes at 0.4 rad/s; nobody touches it",
    PULL_TO_CCW,
    9.0,
    Swing(0.5, 2.0, 3.5, 2.0, 0.8, smooth=False),
    timeout=7.0,
)


def _read(run: ReferenceRun) -> ReferenceRun:
    about = "the same, read by an encoder of 3600 counts a turn"
    return replace(run, name=f"{run.name}_encoder", about=about, encoder=True)


RUNS: tuple[ReferenceRun, ...] = (
    _SMOOTH,
    _read(_SMOOTH),
    _TREMOR,
    _read(_TREMOR),
    _RAMP,
    _read(_RAMP),
    ReferenceRun(
        "force_pulses",
        "half sines of +25 N and -40 N on a handle that reads 4 N at rest; the door stays closed",
        PUSH_TO_CW,
        5.0,
        timeout=3.0,
        pulses=(Pulse(1.007, 0.5, 25.0), Pulse(2.004, 0.4, -40.0)),
        handle_zero=4.0,
    ),
    ReferenceRun(
        "pull_arm_first",
        "pulled on the CCW side: an arm 0.7 m high comes first, the body 0.4 s later",
        PULL_TO_CCW,
        8.0,
        Swing(1.6, 2.0, 4.2, 2.0, 0.9),
        pulses=(Pulse(1.307, 0.5, 20.0),),
        stays=(
            Stay(Side.CCW, 0.813, 1.213, 0.7),
            Stay(Side.CCW, 1.213, 4.013),
            Stay(Side.CW, 3.807, 4.409),
        ),
    ),
    ReferenceRun(
        "push_to_cw",
        "pushed from the CCW side: angle and force are negative; the robot leaves while the panel "
        "passes under the sensors, which see it",
        PUSH_TO_CW,
        8.0,
        Swing(1.6, 2.0, 4.2, 2.0, -0.9),
        pulses=(Pulse(1.307, 0.5, -20.0),),
        stays=(Stay(Side.CCW, 0.913, 3.813), Stay(Side.CW, 3.607, 5.523)),
        panel_seen=True,
    ),
    ReferenceRun(
        "nothing_happens",
        "no touch, no motion, nobody there until the timeout",
        PULL_TO_CW,
        4.0,
        timeout=3.0,
    ),
    ReferenceRun(
        "under_sensors_at_stop",
        "the door closes while the robot still stands under the sensors of its destination",
        PUSH_TO_CCW,
        8.0,
        Swing(1.6, 2.0, 4.2, 2.0, 0.9),
        pulses=(Pulse(1.307, 0.5, 20.0),),
        stays=(Stay(Side.CW, 0.913, 3.813), Stay(Side.CCW, 3.607, 6.507)),
    ),
    ReferenceRun(
        "both_sides_at_stop",
        "the timeout comes while the robot stands on both sides; it leaves the starting side first",
        PUSH_TO_CCW,
        6.0,
        Swing(1.6, 2.0, 90.0, 2.0, 0.9),
        timeout=4.5,
        pulses=(Pulse(1.307, 0.5, 20.0),),
        stays=(Stay(Side.CW, 0.913, 4.813), Stay(Side.CCW, 3.907, 5.307)),
    ),
)
"""All of them."""
