"""How a launch file and arguments of ROS name things."""

from __future__ import annotations

import pytest

from madrob_console.common.clock import SystemClock
from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import REFEREE_STATE_TOPIC
from madrob_console.messages.types import MessageTypes
from madrob_console.testbeds.ros import RosSource
from tests.madrob_console import said
from tests.madrob_console.ros_peer import BOOL, KEPT, Peer, Taker, latch


def test_a_launch_file_moves_topics_into_its_namespace_and_gives_them_other_names(
    peer: Peer,
) -> None:
    ros_args = ["-r", "__ns:=/hall2", "-r", "__node:=referee", "-r", "door/locked:=/lab/latch"]
    moved = RosSource((latch(),), MessageTypes(), SystemClock(), ros_args=ros_args)
    publisher = peer.publisher("/lab/latch", BOOL)
    with Taker(moved) as taker:
        peer.say(taker, publisher, True)
        assert taker.taken[0].topic == "/madrob/door/locked"  # as the settings call it
        states = peer.listen("/hall2/referee/state", "std_msgs/msg/String", KEPT)
        taker.source.publish(said.state("idle"))
        peer.until(lambda: states)

        def speakers() -> list[tuple[str, str]]:
            infos = peer.own.get_publishers_info_by_topic("/hall2/referee/state")
            return [(info.node_namespace, info.node_name) for info in infos]

        peer.until(lambda: speakers() == [("/hall2", "referee")])
        assert not peer.own.get_publishers_info_by_topic(REFEREE_STATE_TOPIC)
        assert taker.source.other_referee is None  # not even itself, by another name


@pytest.mark.usefixtures("ros_domain")
@pytest.mark.parametrize("ros_args", [["-r"], ["--nonsense"], ["-r", "__ns:=hall 2"]])
def test_arguments_that_ros_does_not_understand_are_named_in_one_line(
    ros_args: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(MadrobError, match=r"^`--ros-args .*correct it$") as caught:
        RosSource((latch(),), MessageTypes(), SystemClock(), ros_args=ros_args).open()
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")
