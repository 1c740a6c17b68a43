"""What the simulated testbed's sensors read, noise included."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from random import Random

from madrob_console.testbeds.simulated.geometry import DoorGeometry, RobotBody
from scoring.protocol import Signal, Strip

RANGE_MIN = 0.02
"""m; nearer things are too close for the simulated range finders."""
RANGE_MAX = 4.0
"""m; farther things are out of their reach."""

Reading = float | bool | tuple[float, ...]
"""rad, N, m (four ranges down from the lintel), or whether the latch is engaged."""


@dataclass(frozen=True, slots=True)
class SensorSettings:
    """How the sensors behave.

    Attributes:
        rate: readings a second of each topic, Hz.
        jitter: standard deviation of the instants of reading, s.
        handle_offset: what the load cell reads at rest, N.
        handle_noise: standard deviation of the force, N.
        range_noise: standard deviation of the ranges, m.
        latch: whether there is a latch sensor.
    """

    rate: float = 50.0
    jitter: float = 0.0008
    handle_offset: float = 5.9
    handle_noise: float = 0.05
    range_noise: float = 0.003
    latch: bool = False


@dataclass(frozen=True, slots=True)
class Scene:
    """What is in the doorway at one instant.

    Attributes:
        body: the robot; None = nowhere near.
        x: of the robot's middle in the frame `madrob_door`, m.
        angle: of the panel, rad, positive = CCW.
        contact: force of the hand on the handle, N, positive = pushes towards CCW.
        latched: whether the latch is engaged.
    """

    body: RobotBody | None = None
    x: float = 0.0
    angle: float = 0.0
    contact: float = 0.0
    latched: bool = True


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
        """One reading of one signal."""
        if signal is Signal.DOOR:
            return self.geometry.encode(scene.angle)
        if signal is Signal.HANDLE:
            noise = self._noise[signal].gauss(0.0, self.settings.handle_noise)
            return scene.contact + self.settings.handle_offset + noise
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
