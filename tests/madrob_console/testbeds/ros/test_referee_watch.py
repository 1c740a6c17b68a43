from __future__ import annotations

import os

import pytest

from madrob_console.testbeds.ros.referee_watch import console_name, second_referee
from tests.madrob_console.ros_peer import KEPT, Peer, Taker, source

OWN = ("/madrob", console_name())
STATE = "/madrob/referee/state"
REMEDY = f"{STATE}: end it, or use another ROS domain"
MACHINE = console_name().rpartition("_")[2]
PARENT = f"console_here_{os.getppid()}_{MACHINE}"
NO_PROCESS = 2**22 + 1
"""Above the largest that Linux gives."""


def test_the_name_of_the_node_says_which_process_it_is() -> None:
    assert str(os.getpid()) in console_name().split("_")


def test_only_others_are_second_referees() -> None:
    assert second_referee([OWN]) is None
    assert second_referee([]) is None
    assert second_referee([OWN, OWN]) is not None
    assert second_referee([OWN], own=0) is not None


@pytest.mark.parametrize(
    ("node", "words"),
    [
        (("/", "rosbag2_player"), f"/rosbag2_player publishes {REMEDY}"),
        (("/madrob", "console"), f"/madrob/console publishes {REMEDY}"),
        (
            ("", "_CREATED_BY_BARE_DDS_APP_"),
            f"a program that has not told its name publishes {REMEDY}",
        ),
        (
            ("/madrob", "console_hall_2_4711_0a1b2c"),
            f"/madrob/console_hall_2_4711_0a1b2c (pid 4711 on hall_2) publishes {REMEDY}",
        ),
        (
            ("/madrob", PARENT),
            f"/madrob/{PARENT} (pid {os.getppid()} on here) publishes {REMEDY}",
        ),
        (("/madrob", f"console_here_{NO_PROCESS}_{MACHINE}"), None),
        (("/madrob", f"console_here_{10**30}_{MACHINE}"), None),
    ],
)
def test_another_one_is_named_unless_it_is_known_to_be_gone(
    node: tuple[str, str], words: str | None
) -> None:
    assert second_referee([OWN, node]) == words


def test_several_are_named_together_and_nothing_reaches_a_terminal_raw() -> None:
    words = second_referee([("/b", "two"), OWN, ("/a", "one\x1b[2J")])
    assert words is not None
    assert words.startswith("/a/one")
    assert words.endswith(f"/b/two publish {REMEDY}")
    assert "\x1b" not in words


def test_a_publisher_of_the_state_is_found_and_found_gone(peer: Peer) -> None:
    with Taker(source()) as taker:
        assert taker.source.other_referee is None
        publisher = peer.publisher(STATE, "std_msgs/msg/String", KEPT)
        peer.until(lambda: taker.source.other_referee, 2.0)
        assert taker.source.other_referee == f"/madrob/peer publishes {REMEDY}"
        peer.own.destroy_publisher(publisher)
        peer.until(lambda: taker.source.other_referee is None, 2.0)


def test_who_only_listens_is_no_second_referee(peer: Peer) -> None:
    with Taker(source()) as referee, Taker(source(speaks=False)) as listener:
        # DDS tells of a publisher before it tells of its node
        peer.until(lambda: console_name() in str(listener.source.other_referee))
        assert referee.source.other_referee is None
        assert peer.own.count_publishers(STATE) == 1
