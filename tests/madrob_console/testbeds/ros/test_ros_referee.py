from __future__ import annotations

import json
import math

import pytest

from madrob_console.messages.codec import MessageTypes, decode_text, referee_topics
from madrob_console.testbeds.source import RefereeState
from recorder.bag import Durability
from scoring.protocol import StartPose
from tests.madrob_console.ros_peer import KEPT, TYPES, Peer, Taker, source

STRING = "std_msgs/msg/String"
POSE = "geometry_msgs/msg/PoseStamped"


def state(phase: str) -> RefereeState:
    return RefereeState(phase, None, None, json.dumps({"phase": phase}))


def test_a_late_joiner_hears_the_last_state_the_pose_and_the_events(peer: Peer) -> None:
    with Taker(source()) as taker:
        for phase in ("idle", "countdown", "running"):
            taker.source.announce_state(state(phase))
        for event in ("door_opens", "door_closes"):
            taker.source.announce_event(event)
        taker.source.announce_start_pose(StartPose(1.5, -0.25, 180.0))
        states = peer.listen("/madrob/referee/state", STRING, KEPT)
        events = peer.listen("/madrob/referee/event", STRING, KEPT)
        poses = peer.listen("/madrob/referee/start_pose", POSE, KEPT)
        peer.until(lambda: states and len(events) == 2 and poses)
    assert [json.loads(s.data) for s in states] == [{"phase": "running"}]
    assert [e.data for e in events] == ["door_opens", "door_closes"]
    assert poses[0].header.frame_id == "madrob_door"
    assert (poses[0].pose.position.x, poses[0].pose.position.y) == (1.5, -0.25)
    assert math.isclose(abs(poses[0].pose.orientation.z), 1.0)


def test_a_robot_hears_every_state_change_in_order(peer: Peer) -> None:
    states = peer.listen("/madrob/referee/state", STRING, KEPT)
    phases = ["idle", "ready", "countdown", "running", "stopped", "final"]
    with Taker(source()) as taker:
        peer.until(lambda: peer.own.count_publishers("/madrob/referee/state"))
        for count, phase in enumerate(phases, 1):
            taker.source.announce_state(state(phase))
            peer.until(lambda count=count: len(states) >= count)  # type: ignore[misc]
    assert [json.loads(s.data)["phase"] for s in states] == phases


@pytest.mark.usefixtures("ros_domain")
def test_what_is_recorded_is_what_was_published() -> None:
    with Taker(source()) as taker:
        (message,) = taker.source.announce_state(state("ready"))
        (pose,) = taker.source.announce_start_pose(StartPose(-1.0, 0.0, 0.0))
        known = {t.name: t for t in taker.source.topics()}
    assert (message.topic, message.type) == ("/madrob/referee/state", STRING)
    assert json.loads(decode_text(TYPES, message.data)) == {"phase": "ready"}
    assert TYPES.decode(POSE, pose.data).pose.position.x == -1.0
    assert message.receive_ns == message.publish_ns
    for topic in referee_topics(MessageTypes()):
        assert known[topic.name] == topic
        assert topic.qos.durability is Durability.TRANSIENT_LOCAL
