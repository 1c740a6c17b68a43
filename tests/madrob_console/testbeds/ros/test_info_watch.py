from __future__ import annotations

import time

import pytest

from madrob_console.clock import NS, SimulationClock
from madrob_console.messages.codec import DEFAULT_MAPPINGS, MessageTypes
from madrob_console.testbeds.announcement import INFO_TOPIC, INFO_TYPE, SILENT, info_text
from madrob_console.testbeds.ros import RosSource
from madrob_console.testbeds.ros.loading import RosObject, load_message_class
from tests.madrob_console.ros_peer import KEPT, TYPES, Peer, Taker, source

LIVE = "LIVE ros domain"
SIMULATED = "SIMULATED over ROS domain"
CLOCK = "rosgraph_msgs/msg/Clock"
BEFORE = 1_000_000
"""Long before this program was written, s since the epoch."""


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


def tell(publisher: RosObject, sec: int) -> None:
    stamp = TYPES.make("builtin_interfaces/msg/Time", sec=sec)
    publisher.publish(TYPES.encode(CLOCK, TYPES.make(CLOCK, clock=stamp)))


def test_simulated_time_is_told_and_changes_nothing_where_it_is_not_followed(peer: Peer) -> None:
    with Taker(source()) as taker:
        assert taker.source.announcement == SILENT
        publisher = peer.publisher("/clock", CLOCK)

        def told() -> float | None:
            tell(publisher, 100)
            return taker.source.announcement.simulated_time

        peer.until(told)
        assert told() == pytest.approx(100 - time.time(), abs=10)
        assert taker.source.label.startswith(LIVE)
        peer.own.destroy_publisher(publisher)
        peer.until(lambda: taker.source.announcement == SILENT)


def test_an_engine_that_follows_simulated_time_says_so_and_whether_it_is_there(peer: Peer) -> None:
    clock, second = SimulationClock(), 100
    publisher = peer.publisher("/clock", CLOCK)

    def told() -> bool:
        nonlocal second
        second += 1
        tell(publisher, second)
        return BEFORE * NS > clock.now_ns() > second * NS

    def silent() -> bool:
        wanted = "/clock is silent: start the simulation"
        return all(status.problem == wanted for status in taker.source.status())

    with Taker(RosSource(DEFAULT_MAPPINGS, MessageTypes(), clock)) as taker:
        assert taker.source.announcement.simulated == "time of /clock"
        assert taker.source.label.startswith(SIMULATED)
        peer.until(silent)
        peer.until(told)
        peer.until(lambda: not silent())
        offset = taker.source.announcement.simulated_time
        assert offset is not None
        assert abs(offset) < 1.5
        peer.until(silent)
