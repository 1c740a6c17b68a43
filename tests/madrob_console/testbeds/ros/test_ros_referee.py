from __future__ import annotations

import json
import math

from madrob_console.messages.codec import MessageTypes, referee_topics
from recorder.bag import Durability
from scoring.protocol import StartPose
from tests.madrob_console import said
from tests.madrob_console.ros_peer import KEPT, Peer, Taker, source

STRING = "std_msgs/msg/String"
POSE = "geometry_msgs/msg/PoseStamped"


def test_a_late_joiner_hears_the_last_state_the_pose_and_the_events(peer: Peer) -> None:
    with Taker(source()) as taker:
        for phase in ("idle", "countdown", "running"):
            taker.source.publish(said.state(phase))
        for event in ("door_opens", "door_closes"):
            taker.source.publish(said.event(event))
        taker.source.publish(said.start_pose(StartPose(1.5, -0.25, 180.0)))
        states = peer.listen("/madrob/referee/state", STRING, KEPT)
        events = peer.listen("/madrob/referee/event", STRING, KEPT)
        poses = peer.listen("/madrob/referee/start_pose", POSE, KEPT)
        peer.until(lambda: states and len(events) == 2 and poses)
    assert [json.loads(s.data)["phase"] for s in states] == ["running"]
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
            taker.source.publish(said.state(phase))
            peer.until(lambda count=count: len(states) >= count)  # type: ignore[misc]
    assert [json.loads(s.data)["phase"] for s in states] == phases


def test_the_bytes_that_are_published_are_those_of_the_message(peer: Peer) -> None:
    message = said.state("ready", 12.5)
    with Taker(source()) as taker:
        taker.source.publish(message)
        heard = peer.listen_raw(message.topic, STRING, KEPT)
        peer.until(lambda: heard)
        known = {topic.name: topic for topic in taker.source.topics()}
    assert heard == [message.data]
    for topic in referee_topics(MessageTypes()):
        assert known[topic.name] == topic
        assert topic.qos.durability is Durability.TRANSIENT_LOCAL
