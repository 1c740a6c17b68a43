from __future__ import annotations

from madrob_console.testbeds.announcement import INFO_TOPIC, INFO_TYPE, SILENT, info_text
from madrob_console.testbeds.ros.loading import load_message_class
from tests.madrob_console.ros_peer import KEPT, Peer, Taker, source

LIVE = "LIVE ros domain"
SIMULATED = "SIMULATED over ROS domain"


def announce(peer: Peer, text: str) -> object:
    """Say something, once for all; returns the publisher."""
    publisher = peer.publisher(INFO_TOPIC, INFO_TYPE, KEPT)
    publisher.publish(load_message_class(INFO_TYPE)(data=text))
    return publisher


def test_what_was_announced_before_is_heard_and_goes_with_who_said_it(peer: Peer) -> None:
    publisher = announce(peer, info_text("slam"))
    with Taker(source()) as taker:
        peer.until(lambda: taker.source.announcement.simulated == "slam")
        assert taker.source.label.startswith(SIMULATED)
        (message,) = taker.source.announcement.messages
        assert info_text("slam").encode() in message.data
        assert INFO_TOPIC in {topic.name for topic in taker.source.topics()}
        peer.own.destroy_publisher(publisher)
        peer.until(lambda: taker.source.announcement == SILENT)
        assert taker.source.label.startswith(LIVE)
        assert INFO_TOPIC not in {topic.name for topic in taker.source.topics()}


def test_what_is_announced_late_is_heard_too_and_one_of_two_testbeds_is_enough(
    peer: Peer,
) -> None:
    with Taker(source()) as taker:
        real = announce(peer, '{"kind": "real"}')
        peer.until(lambda: taker.source.announcement.messages)
        assert taker.source.announcement.simulated is None
        simulated = announce(peer, info_text("slow"))
        peer.until(lambda: taker.source.announcement.simulated == "slow")
        real.publish(load_message_class(INFO_TYPE)(data='{"kind": "real"}'))  # type: ignore[attr-defined]
        peer.spin(1.0)
        assert taker.source.announcement.simulated == "slow"
        peer.own.destroy_publisher(simulated)
        real.publish(load_message_class(INFO_TYPE)(data='{"kind": "real"}'))  # type: ignore[attr-defined]
        peer.until(lambda: taker.source.announcement.simulated is None)


def test_garbage_and_megabytes_make_no_run_practice_and_are_named(peer: Peer) -> None:
    with Taker(source()) as taker:
        publisher = announce(peer, "MADROB \x1b[2J rev 3")
        peer.until(lambda: taker.source.announcement.problem)
        told = taker.source.announcement
        assert told.problem is not None
        assert told.problem.startswith("not understood: 'MADROB")
        assert told.problem.isprintable()
        assert told.simulated is None
        huge = info_text("x" * 3_000_000)
        publisher.publish(load_message_class(INFO_TYPE)(data=huge))  # type: ignore[attr-defined]
        peer.until(lambda: "bytes are no announcement" in str(taker.source.announcement.problem))
        assert not taker.source.announcement.messages  # nor is it recorded
        assert taker.source.announcement.simulated is None
        assert taker.source.label.startswith(LIVE)
