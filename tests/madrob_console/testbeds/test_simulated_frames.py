from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from madrob_console.clock import VirtualClock, seconds
from madrob_console.messages.codec import DEFAULT_MAPPINGS, MessageTypes
from madrob_console.messages.message_types import Message
from madrob_console.testbeds.simulated import DoorGeometry, SimulatedTestbed
from madrob_console.testbeds.simulated.frames import FRAMES_TOPIC
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from recorder.bag import Durability
from recorder.reader import read_bag
from scoring.protocol import Signal, Strip
from tests.madrob_console.recorded_runs import completed

TYPES = MessageTypes()
START_NS = 1_700_000_000_000_000_000
STRIPS = {m.topic: strip for strip in Strip for m in DEFAULT_MAPPINGS
          if m.signal is Signal.of_strip(strip)}  # fmt: skip
Vector = NDArray[np.float64]


def turned(rotation: Message, vector: Vector) -> Vector:
    """A vector turned by a quaternion."""
    axis = np.array([rotation.x, rotation.y, rotation.z])
    twice = 2 * np.cross(axis, vector)
    return np.asarray(vector + rotation.w * twice + np.cross(axis, twice), float)


def transforms(messages: list[Message]) -> dict[str, Message]:
    """The transforms of the only message of them, by frame."""
    (message,) = messages
    return {stamped.child_frame_id: stamped for stamped in message.transforms}


@pytest.mark.parametrize("hinge_left", [True, False])
def test_each_ray_of_a_scan_meets_the_ground_below_its_sensor(hinge_left: bool) -> None:
    geometry = DoorGeometry(hinge_left=hinge_left)
    source = SimulatedSource(SimulatedTestbed(geometry=geometry), VirtualClock(START_NS), TYPES)
    source.open()
    found = transforms([TYPES.decode(m.type, m.data) for m in source.announcement.messages])
    scans = {m.topic: TYPES.decode(m.type, m.data) for m in source.take(0.1) if m.topic in STRIPS}
    assert set(scans) == set(STRIPS)
    for topic, scan in scans.items():
        stamped = found[scan.header.frame_id]
        assert stamped.header.frame_id == "madrob_door"
        assert scan.angle_max == pytest.approx(scan.angle_min + 3 * scan.angle_increment)
        place = stamped.transform.translation
        origin = np.array([place.x, place.y, place.z])
        for mount in (m for m in geometry.mounts if m.strip is STRIPS[topic]):
            angle = scan.angle_min + mount.element * scan.angle_increment
            ray = turned(
                stamped.transform.rotation, np.array([math.cos(angle), math.sin(angle), 0.0])
            )
            ground = origin + ray * (geometry.lintel_height / -ray[2])
            y = geometry.doorway_width / 2 - mount.reach
            expected = [mount.x, y if hinge_left else -y, 0.0]
            assert ground == pytest.approx(expected, abs=0.002)


def test_a_recording_has_a_frame_in_every_message_and_all_of_them_hang_on_the_door() -> None:
    bag = read_bag(completed())
    messages = [(m.topic, m.receive_ns, TYPES.decode(m.type, m.data)) for m in bag.messages()]
    found = transforms([message for topic, _, message in messages if topic == FRAMES_TOPIC])
    assert {stamped.header.frame_id for stamped in found.values()} == {"madrob_door"}
    named = {message.header.frame_id for _, _, message in messages if hasattr(message, "header")}
    assert named == {"madrob_door", *found}
    (topic,) = (topic for topic in bag.topics() if topic.name == FRAMES_TOPIC)
    assert topic.qos.durability is Durability.TRANSIENT_LOCAL
    assert topic.type_hash.startswith("RIHS01_")
    begin = min(received for _, received, _ in messages)
    told = next(received for topic, received, _ in messages if topic == FRAMES_TOPIC)
    assert seconds(told - begin) < 0.1
