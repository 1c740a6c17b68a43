"""The names of frames and the angles of scans in the simulated sensors' headers, for ROS."""

from __future__ import annotations

from madrob_console.messages.codec import START_POSE_FRAME
from madrob_console.messages.mapping import STRIPS
from madrob_console.testbeds.simulated.geometry import DoorGeometry
from scoring.protocol import SENSORS_PER_STRIP, Signal


def frame_name(signal: Signal) -> str:
    if signal is Signal.HANDLE:
        return "madrob_handle"
    strip = STRIPS.get(signal)
    return START_POSE_FRAME if strip is None else f"madrob_passage_{strip}"


def scan_angles(geometry: DoorGeometry) -> dict[str, float]:
    """The angles of a strip's `LaserScan`, by field, rad.

    A scan has rays from one point, although the sensors look straight down, side by side. The rays
    are spread so that each meets the ground below its sensor.
    """
    between = geometry.sensor_spacing / geometry.lintel_height
    most = between * (SENSORS_PER_STRIP - 1) / 2
    return {"angle_min": -most, "angle_max": most, "angle_increment": between}
