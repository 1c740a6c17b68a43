from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import closing

import pytest

from madrob_console.testbeds.evidence_choice import EvidenceChoice
from madrob_console.testbeds.ros.evidence_domain import EvidenceIntakes
from madrob_console.testbeds.ros.handover import Handover
from madrob_console.testbeds.ros.inbox import Received
from madrob_console.testbeds.ros.loading import load_message_class
from madrob_console.testbeds.ros_domain import domain_id
from tests.madrob_console.ros_peer import Peer

GOOD, BAD = "/hall/good", "/hall/bad"
STRING = "std_msgs/msg/String"


@pytest.fixture
def intakes() -> Iterator[EvidenceIntakes]:
    domain = domain_id(None, os.environ)
    choice = EvidenceChoice(("/hall/**",))
    made = EvidenceIntakes(domain, choice, (), environment=os.environ, name="evidence_here")
    with closing(made):
        yield made


def test_a_topic_that_ros_refuses_is_named_and_no_other_pays_for_it(
    peer: Peer, intakes: EvidenceIntakes, monkeypatch: pytest.MonkeyPatch
) -> None:
    publishers = [peer.publisher(topic, STRING) for topic in (GOOD, BAD)]
    take = Handover.take
    refused = True

    def refusing(self: Handover, most: int | None = None) -> list[Received]:
        if refused and self._name == BAD:
            raise RuntimeError("failed to take a message\nwith a long story")
        return take(self, most)

    monkeypatch.setattr(Handover, "take", refusing)
    came: set[str] = set()

    def comes() -> set[str]:
        intakes.discover(recording=False)
        for publisher in publishers:
            publisher.publish(load_message_class(STRING)(data="seen"))
        came.update(one.topic.name for one in intakes.take(time.time_ns) if one.messages)
        return came

    peer.until(lambda: GOOD in comes() and problems(intakes)[BAD])
    assert problems(intakes)[GOOD] == ""
    assert problems(intakes)[BAD].endswith("ROS refuses it: failed to take a message")
    refused = False
    assert BAD not in came
    intakes.begin()
    peer.until(lambda: BAD in comes())
    assert problems(intakes)[BAD] == ""


def problems(intakes: EvidenceIntakes) -> dict[str, str]:
    return {flow.topic: flow.problem for flow in intakes.flows()}
