"""Geometry of the simulated testbed (protocol sections 1, 4).

Distances are from the hinge along the closed panel (*reach*) and from the wall on one side
(*distance*). A body is a box and the panel a bar; a sensor sees what comes within `beam_radius`
of its axis.

The defaults are a doorway of 1 m with eight sensors a side, evenly spaced, 0.175 m from the wall.
With them each used sensor sees the panel only well inside of its mask in the protocol's table, so
that a panel that turns at up to `fastest_panel` never passes under an unmasked sensor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from scoring.protocol import PASSAGE_SENSORS, PassageSensor, Side, Strip, Thresholds

SENSORS_PER_SIDE = 8
_ROWS = {
    # From the far end of the doorway to the hinge.
    Side.CW: [(s, e) for s in (Strip.CW_RIGHT, Strip.CW_LEFT) for e in (3, 2, 1, 0)],
    Side.CCW: [(Strip.CCW_LEFT, e) for e in (3, 2, 1, 0)]
    + [(Strip.CCW_RIGHT, e) for e in (0, 1, 2, 3)],
}
_LONGEST_STALENESS = 0.024
"""s that the door angle may be older than the reading it masks: one period and jitter."""


@dataclass(frozen=True, slots=True)
class RobotBody:
    """A box that moves along the doorway axis; its middle is `shift` m further from the hinge."""

    length: float = 0.5
    width: float = 0.5
    height: float = 1.2
    shift: float = 0.22


@dataclass(frozen=True, slots=True)
class Mount:
    """One of the sixteen sensors: its place in its strip and above the ground."""

    side: Side
    strip: Strip
    element: int
    distance: float
    reach: float

    @property
    def x(self) -> float:
        return self.side.sign * self.distance


@dataclass(frozen=True, slots=True)
class DoorGeometry:
    """The doorway, its panel and its sensors; lengths in m.

    `sensor_distance` is that of each row from the wall; the rows are centred on the doorway.
    """

    doorway_width: float = 1.0
    panel_length: float = 0.98
    panel_thickness: float = 0.04
    panel_height: float = 1.95
    lintel_height: float = 2.0
    sensor_distance: float = 0.175
    sensor_spacing: float = 0.125
    beam_radius: float = 0.02
    thresholds: Thresholds = field(default_factory=Thresholds)

    @property
    def mounts(self) -> tuple[Mount, ...]:
        first = self.doorway_width / 2 + self.sensor_spacing * (SENSORS_PER_SIDE - 1) / 2
        return tuple(
            Mount(side, strip, element, self.sensor_distance, first - i * self.sensor_spacing)
            for side, row in _ROWS.items()
            for i, (strip, element) in enumerate(row)
        )

    def mount(self, sensor: PassageSensor) -> Mount:
        place = (sensor.strip, sensor.element)
        return next(m for m in self.mounts if (m.strip, m.element) == place)

    @property
    def fastest_panel(self) -> float:
        """rad/s up to which no sensor sees the panel while a stale angle leaves it unmasked."""
        margins = []
        for sensor in PASSAGE_SENSORS:
            seen = self.panel_seen(self.mount(sensor))
            if seen is not None:
                low, high = self.mask(sensor)
                margins += [seen[0] - low, high - seen[1]]
        return min(margins, default=math.inf) / _LONGEST_STALENESS

    def mask(self, sensor: PassageSensor) -> tuple[float, float]:
        """The panel angles, rad, on the sensor's side between which the protocol ignores it."""
        return self.thresholds.mask(sensor.side, sensor.index)

    def panel_seen(self, mount: Mount) -> tuple[float, float] | None:
        """The panel angles, rad, on its side between which a sensor sees it; None = never."""
        radius = math.hypot(mount.distance, mount.reach)
        half = self.panel_thickness / 2 + self.beam_radius
        if radius - self.beam_radius > self.panel_length:
            return None
        middle = math.atan2(mount.distance, mount.reach)
        spread = math.asin(min(1.0, half / radius))
        return middle - spread, middle + spread

    def sees_panel(self, mount: Mount, sine: float, cosine: float) -> bool:
        distance = mount.distance if sine * mount.side.sign > 0 else -mount.distance
        along = distance * abs(sine) + mount.reach * cosine
        across = distance * cosine - mount.reach * abs(sine)
        half = self.panel_thickness / 2 + self.beam_radius
        return abs(across) < half and 0 < along < self.panel_length + self.beam_radius

    def half_view(self, body: RobotBody) -> float:
        """The largest distance along x, m, at which a sensor still sees a body's middle."""
        return body.length / 2 + self.beam_radius

    def covers(self, body: RobotBody, mount: Mount) -> bool:
        reach = self.doorway_width / 2 + body.shift
        return abs(reach - mount.reach) < body.width / 2 + self.beam_radius

    def clear_distance(self, body: RobotBody) -> float:
        """The distance of a body's middle from the threshold, m, that no sensor sees."""
        return self.sensor_distance + self.half_view(body)

    def encode(self, angle: float) -> float:
        count = self.thresholds.encoder_count
        return round(angle / count) * count
