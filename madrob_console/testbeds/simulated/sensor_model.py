"""What the simulated sensors read."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from random import Random

from madrob_console.testbeds.simulated.geometry import DoorGeometry, RobotBody
from madrob_console.testbeds.simulated.motion import MotionPlan
from scoring.protocol import Signal, Strip

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
