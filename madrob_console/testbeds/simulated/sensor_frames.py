"""Where the simulated sensors are, for ROS: frames in headers, and `/tf_static`.

All frames hang on `madrob_door` (protocol section 1), so that Foxglove and RViz can show scans
and start pose together. The testbed's interface does not need them, and a real one may name
others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from madrob_console.common.clock import NS
from madrob_console.messages.codec import START_POSE_FRAME, STRIPS
from madrob_console.messages.message_types import MessageTypes
from madrob_console.testbeds.simulated.geometry import DoorGeometry
from recorder.bag import RawMessage
from scoring.protocol import SENSORS_PER_STRIP, Signal, Strip

FRAMES_TOPIC = "/tf_static"
FRAMES_TYPE = "tf2_msgs/msg/TFMessage"

_HALF = math.sqrt(0.5)
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)
_DOWN_TO_LEFT = (0.0, _HALF, 0.0, _HALF)
_DOWN_TO_RIGHT = (_HALF, 0.0, -_HALF, 0.0)
"""Turned so that x points down and y along the wall, to the left or right when looking to CCW."""

_TRANSFORM = "geometry_msgs/msg/TransformStamped"


@dataclass(frozen=True, slots=True)
class StandingFrame:
    """A static frame in `madrob_door`: origin x, y, z in m, and a quaternion x, y, z, w."""

    name: str
    place: tuple[float, float, float]
    turn: tuple[float, float, float, float]


def frame_name(signal: Signal) -> str:
    if signal is Signal.HANDLE:
        return "madrob_handle"
    strip = STRIPS.get(signal)
    return START_POSE_FRAME if strip is None else f"madrob_passage_{strip}"


def frames(geometry: DoorGeometry) -> tuple[StandingFrame, ...]:
    """The frames of handle and strips.

    The handle's is where the handle is while the door is closed: x is the direction of a positive
    force, which turns with the panel in truth. A strip's has x down, and y towards its last sensor.
    """
    free_end = _along_wall(geometry, geometry.panel_length)
    handle = StandingFrame(
        frame_name(Signal.HANDLE), (0.0, free_end, geometry.panel_height / 2), _UPRIGHT
    )
    return (handle, *(_strip_frame(geometry, strip) for strip in Strip))


def scan_angles(geometry: DoorGeometry) -> dict[str, float]:
    """The angles of a strip's `LaserScan`, by field, rad.

    A scan has rays from one point, although the sensors look straight down, side by side. The rays
    are spread so that each meets the ground below its sensor.
    """
    between = geometry.sensor_spacing / geometry.lintel_height
    most = between * (SENSORS_PER_STRIP - 1) / 2
    return {"angle_min": -most, "angle_max": most, "angle_increment": between}


def encode_frames(types: MessageTypes, geometry: DoorGeometry, time_ns: int) -> RawMessage:
    transforms = []
    for frame in frames(geometry):
        stamped = types.make(_TRANSFORM, child_frame_id=frame.name)
        stamped.header.frame_id = START_POSE_FRAME
        stamped.header.stamp.sec, stamped.header.stamp.nanosec = divmod(time_ns, NS)
        place, turn = stamped.transform.translation, stamped.transform.rotation
        place.x, place.y, place.z = frame.place
        turn.x, turn.y, turn.z, turn.w = frame.turn
        transforms.append(stamped)
    data = types.encode(FRAMES_TYPE, types.make(FRAMES_TYPE, transforms=transforms))
    return RawMessage(FRAMES_TOPIC, FRAMES_TYPE, data, time_ns, time_ns)


def _strip_frame(geometry: DoorGeometry, strip: Strip) -> StandingFrame:
    mounts = {mount.element: mount for mount in geometry.mounts if mount.strip is strip}
    first, last = mounts[0], mounts[SENSORS_PER_STRIP - 1]
    begin, end = (_along_wall(geometry, mount.reach) for mount in (first, last))
    place = (first.x, (begin + end) / 2, geometry.lintel_height)
    turn = _DOWN_TO_LEFT if end > begin else _DOWN_TO_RIGHT
    return StandingFrame(frame_name(Signal.of_strip(strip)), place, turn)


def _along_wall(geometry: DoorGeometry, reach: float) -> float:
    return geometry.doorway_width / 2 - reach
