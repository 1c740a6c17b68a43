"""Publishes over ROS what a testbed, its cameras and strangers publish.

The hands start it as a process of its own, which ends with them:

    python -m tests.stories.publisher SPEECH ...

Each SPEECH is one of `SPEECHES`. The door waits until the referee says that the run goes on. A
robot then touches it, opens it, crosses and closes it, in less than five seconds. At the slow door
that takes twice as long, and the open door is never closed.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any

import rclpy
import rclpy.qos
from geometry_msgs.msg import WrenchStamped
from sensor_msgs.msg import CompressedImage, JointState, LaserScan
from std_msgs.msg import Bool, Float64, String

PERIOD = 0.02
QOS: Any = rclpy.qos
STRIPS = ("cw_left", "cw_right", "ccw_left", "ccw_right")
LINTEL, BODY = 2.0, 1.5
REST = 4.0  # N, of the handle
FLOOD = 40  # messages of a stranger for each one of the door
GRAVITY = 9.80665


def way(since: float, begins: float, lasts: float) -> float:
    """Return the part of a smooth motion that is done, 0 to 1."""
    x = min(1.0, max(0.0, (since - begins) / lasts))
    return x**3 * (10 - 15 * x + 6 * x**2)


def angle(since: float, *, closes: bool) -> float:
    closed = way(since, 2.4, 1.2) if closes else 0.0
    return 0.9 * (way(since, 0.8, 1.2) - closed)


def force(since: float) -> float:
    pull = 30.0 * math.sin(math.pi * (since - 0.5) / 0.4)
    return REST + pull if 0.5 < since < 0.9 else REST


def height(side: str, since: float) -> float:
    """Return the height of what stands under a side; the run starts on CCW."""
    there = 0.4 < since < 1.9 if side == "ccw" else 1.7 < since < 2.2
    return BODY if there else 0.0


class Stranger:
    """A node and what it publishes."""

    def __init__(self) -> None:
        self.node = rclpy.create_node("stranger")
        self.start = math.inf
        self.pace = 1.0
        self.closes = True
        kept = QOS.QoSProfile(depth=1, durability=QOS.DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(Bool, "/madrob/referee/running", self.hear, kept)
        self._publishers: dict[str, Any] = {}
        self._counts: Counter[type] = Counter()

    def hear(self, running: Bool) -> None:
        if running.data and self.start == math.inf:
            self.start = time.monotonic()

    @property
    def since(self) -> float:
        """Seconds since the run began, as the robot counts them; -1 before it."""
        return max(-1.0, self.pace * (time.monotonic() - self.start))

    def publish(self, topic: str, message: Any) -> None:  # noqa: ANN401  of any type
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(type(message), topic, 100)
        self._publishers[topic].publish(message)

    def stamped(self, message: Any) -> Any:  # noqa: ANN401  of any type
        """Give a message the time, and as its frame the number that it has in its type."""
        message.header.stamp = self.node.get_clock().now().to_msg()
        message.header.frame_id = str(self._counts[type(message)])
        self._counts[type(message)] += 1
        return message

    # --- the door

    def angle(self) -> float:
        return angle(self.since, closes=self.closes)

    def slow_door(self) -> None:
        self.pace = 0.5
        self.door()

    def open_door(self) -> None:
        self.closes = False
        self.door()

    def door(self) -> None:
        self.publish(
            "/madrob/door/angle",
            self.stamped(JointState(name=["door"], position=[self.angle()])),
        )
        wrench = self.stamped(WrenchStamped())
        wrench.wrench.force.x = force(self.since)
        self.publish("/madrob/handle/force", wrench)
        self.strips("/madrob/passage", 1.0)

    def lab_door(self) -> None:
        """The same with names and units of a laboratory."""
        degrees = math.degrees(self.angle())
        joints = JointState(name=["arm", "door", "lock"], position=[0.3, degrees, 1.0])
        self.publish("/lab/joints", self.stamped(joints))
        wrench = self.stamped(WrenchStamped())
        wrench.wrench.force.z = force(self.since) / GRAVITY * 1000.0
        self.publish("/lab/load_cell", wrench)
        self.strips("/lab/ranges", 1000.0)

    def strips(self, prefix: str, unit: float) -> None:
        for strip in STRIPS:
            distance = (LINTEL - height(strip.partition("_")[0], self.since)) * unit
            scan = LaserScan(range_min=0.02 * unit, range_max=4.0 * unit, ranges=[distance] * 4)
            self.publish(f"{prefix}/{strip}", self.stamped(scan))

    # --- cameras and strangers

    def camera(self) -> None:
        picture = CompressedImage(format="jpeg", data=bytes(20_000))
        self.publish("/camera/front/image/compressed", self.stamped(picture))

    def flood(self) -> None:
        """A stranger floods the handle's topic, with stamps of long ago."""
        for _ in range(FLOOD):
            self.publish("/madrob/handle/force", WrenchStamped())

    def nan(self) -> None:
        """A second encoder says NaN and infinity."""
        values = [math.nan if time.time() % 1 < 0.5 else math.inf]
        self.publish("/madrob/door/angle", self.stamped(JointState(position=values)))

    def wrong_type(self) -> None:
        self.publish("/madrob/passage/cw_left", String(data="no ranges"))
        self.publish("/madrob/door/locked", Float64(data=math.nan))

    def escapes(self) -> None:
        """Names and texts that would move a terminal's cursor and set its title."""
        evil = "\x1b]0;owned\x07\x1b[2J\x1b[31mred"
        self.publish("/madrob/door/angle", self.stamped(JointState(name=[evil], position=[9.0])))
        self.publish("/camera/evil/image/compressed", self.stamped(CompressedImage(format=evil)))
        self.publish("/madrob/robot/finished", String(data=evil))


SPEECHES: dict[str, Callable[[Stranger], None]] = {
    "door": Stranger.door,
    "slow door": Stranger.slow_door,
    "open door": Stranger.open_door,
    "lab door": Stranger.lab_door,
    "camera": Stranger.camera,
    "flood": Stranger.flood,
    "nan": Stranger.nan,
    "wrong type": Stranger.wrong_type,
    "escapes": Stranger.escapes,
}


def main(names: list[str]) -> None:
    rclpy.init()
    stranger = Stranger()
    speeches = [partial(SPEECHES[name], stranger) for name in names]
    due = time.monotonic()
    while True:
        for speech in speeches:
            speech()
        due += PERIOD
        while (left := due - time.monotonic()) > 0:
            rclpy.spin_once(stranger.node, timeout_sec=left)


if __name__ == "__main__":
    main(sys.argv[1:])
