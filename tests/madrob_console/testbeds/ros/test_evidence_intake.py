"""Topics of the evidence as they are found, without a process around them."""

from __future__ import annotations

import os
import time

import pytest

from madrob_console.testbeds.evidence_choice import EvidenceChoice
from madrob_console.testbeds.ros import evidence_intake
from madrob_console.testbeds.ros.evidence_intakes import EvidenceIntakes
from madrob_console.testbeds.ros.handover import Handover
from recorder.bag import Durability, Reliability
from tests.madrob_console.ros_peer import BEST_EFFORT, BOOL, KEPT, Peer, truth

HEADER = "std_msgs/msg/Header"


class Listening:
    """Intakes, and what they have taken by topic."""

    def __init__(self, domain: int, *topics: str) -> None:
        choice = EvidenceChoice(topics)
        self.intakes = EvidenceIntakes(
            domain, choice, ("/hall/own",), environment=os.environ, name="listens"
        )
        self.taken: dict[str, list[bytes]] = {}

    def look(self, *, recording: bool = False) -> None:
        self.intakes.discover(recording=recording)
        for taken in self.intakes.take(time.time_ns):
            self.taken.setdefault(taken.topic.name, []).extend(m.data for m in taken.messages)

    def looked(self, topic: str) -> str:
        """What is wrong with a topic, after one more look."""
        self.look()
        return self.problem(topic)

    def problem(self, topic: str) -> str:
        return next((f.problem for f in self.intakes.flows() if f.topic == topic), "not there")

    def qos(self, topic: str) -> tuple[Reliability, Durability] | None:
        known = self.intakes._intakes[topic].topic
        return None if known is None else (known.qos.reliability, known.qos.durability)


def test_each_topic_is_asked_for_as_its_publishers_offer_it(ros_domain: int, peer: Peer) -> None:
    here = Listening(ros_domain, "/hall/**")
    offered = {"/hall/reliable": None, "/hall/lossy": BEST_EFFORT, "/hall/kept": KEPT}
    senders = [
        peer.publisher(name, BOOL, qos) if qos else peer.publisher(name, BOOL)
        for name, qos in offered.items()
    ]
    own = peer.publisher("/hall/own", BOOL)

    def heard() -> bool:
        for sender in (*senders, own):
            sender.publish(truth(True))
        here.look()
        return all(here.taken.get(name) for name in offered)

    peer.until(heard)
    assert set(here.taken) == set(offered)
    assert here.qos("/hall/lossy") == (Reliability.BEST_EFFORT, Durability.VOLATILE)
    assert here.qos("/hall/kept") == (Reliability.RELIABLE, Durability.TRANSIENT_LOCAL)
    late = peer.publisher("/hall/reliable", BOOL, BEST_EFFORT)
    weaker = (Reliability.BEST_EFFORT, Durability.VOLATILE)

    def adapted() -> bool:
        here.look()
        return here.qos("/hall/reliable") == weaker

    peer.until(adapted)
    before = len(here.taken["/hall/reliable"])

    def heard_late() -> bool:
        late.publish(truth(False))
        here.look()
        return len(here.taken["/hall/reliable"]) > before

    peer.until(heard_late)
    here.intakes.close()


def test_a_type_stays_while_it_is_recorded_and_changes_between_runs(
    ros_domain: int, peer: Peer
) -> None:
    here = Listening(ros_domain, "/hall/state")
    first = peer.publisher("/hall/state", BOOL)
    peer.until(lambda: not here.looked("/hall/state"))
    peer.own.destroy_publisher(first)
    peer.publisher("/hall/state", HEADER)

    def changed() -> bool:
        here.look(recording=True)
        return "its type has become std_msgs/msg/Header" in here.problem("/hall/state")

    peer.until(changed)
    peer.until(lambda: not here.looked("/hall/state"))
    assert {flow.type for flow in here.intakes.flows()} == {HEADER}
    here.intakes.close()


def test_a_topic_on_which_ros_fails_is_named_and_ends_no_other(
    ros_domain: int, peer: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Failing(Handover):
        def listen(self, qos: object, publishers: int) -> None:
            if self._name == "/hall/bad":
                raise RuntimeError("no such thing\nas a subscription")
            super().listen(qos, publishers)  # type: ignore[arg-type]

    monkeypatch.setattr(evidence_intake, "Handover", Failing)
    here = Listening(ros_domain, "/hall/**")
    bad, good = (peer.publisher(f"/hall/{name}", BOOL) for name in ("bad", "good"))

    def heard() -> bool:
        bad.publish(truth(True))
        good.publish(truth(True))
        here.look()
        return bool(here.taken.get("/hall/good")) and "ROS fails" in here.problem("/hall/bad")

    peer.until(heard)
    assert here.problem("/hall/bad") == "ROS fails (no such thing)"
    assert here.problem("/hall/good") == ""
    here.intakes.close()


def test_what_nobody_publishes_and_what_has_gone_is_known(ros_domain: int, peer: Peer) -> None:
    here = Listening(ros_domain, "/hall/named", "/hall/never", "/hall/own", "/none/**")
    sender = peer.publisher("/hall/named", BOOL)

    def seen() -> bool:
        here.look()
        return "/hall/named" not in here.intakes.unseen

    peer.until(seen)
    assert here.intakes.unseen == ("/hall/never", "/none/**")
    assert here.intakes.scored == ("/hall/own",)
    peer.until(lambda: here.looked("/hall/named") == "nothing has come")

    def heard() -> bool:
        sender.publish(truth(True))
        here.look()
        return bool(here.taken.get("/hall/named"))

    peer.until(heard)
    assert here.problem("/hall/named") == ""
    peer.own.destroy_publisher(sender)
    peer.until(lambda: here.looked("/hall/named") == "" and here.intakes.flows()[0].silent)
    assert "/hall/named" not in here.intakes.unseen
