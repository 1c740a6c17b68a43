from __future__ import annotations

import pytest

from madrob_console.testbeds.ros.loading import RosObject, load_module
from madrob_console.testbeds.ros.parameters import door_parameters
from scoring.protocol import BenchmarkType, Condition, Side
from tests.madrob_console.ros_peer import Peer, Taker, source

SUDDEN_CW = Condition(BenchmarkType.SUDDEN_FORCE, opening_side=Side.CW, starting_side=Side.CCW)
NO_FORCE_CCW = Condition(BenchmarkType.NO_FORCE, opening_side=Side.CCW, starting_side=Side.CCW)


def door_node(
    peer: Peer, *, without: str = "", read_only: str = "", spun: bool = True
) -> RosObject:
    """A node `/madrob/door` as a testbed has it."""
    descriptor = load_module("rcl_interfaces.msg").ParameterDescriptor
    node = peer.node("door", spun=spun, parameter_services=True)
    for name, value in door_parameters(NO_FORCE_CCW).items():
        if name != without:
            node.declare_parameter(name, value, descriptor(read_only=name == read_only))
    return node


def test_the_parameters_are_those_of_the_protocol() -> None:
    parameters = door_parameters(SUDDEN_CW)
    assert parameters["opening_side"] == "CW"
    assert parameters["benchmark_type"] == "Sudden Force"
    assert parameters["brake_enabled"] is True
    cw, ccw = parameters["brake_lut_cw"], parameters["brake_lut_ccw"]
    assert isinstance(cw, list)
    assert cw == [0] * 112 + [4000] * 69
    assert ccw == cw[::-1]
    assert door_parameters(NO_FORCE_CCW)["brake_enabled"] is False


def test_the_parameters_reach_the_testbed_and_are_confirmed(peer: Peer) -> None:
    door = door_node(peer)
    with Taker(source()) as taker:
        assert taker.source.sides_problem == "the testbed's sides are not set yet: set up a run"
        taker.source.configure(SUDDEN_CW)
        assert taker.source.sides_problem == "node /madrob/door has not confirmed the sides yet"
        peer.until(lambda: taker.source.sides_problem is None)
    wanted = door_parameters(SUDDEN_CW)
    assert {name: _plain(door.get_parameter(name).value) for name in wanted} == wanted


def test_without_the_node_the_sides_must_be_set_by_hand_until_it_appears(peer: Peer) -> None:
    absent = "node /madrob/door is not there: set the opening side by hand"
    with Taker(source()) as taker:
        taker.source.configure(SUDDEN_CW)
        peer.until(lambda: taker.source.sides_problem == absent)
        door = door_node(peer)
        peer.until(lambda: taker.source.sides_problem is None)
        peer.end_node(door)
        peer.until(lambda: taker.source.sides_problem == absent)


def test_a_restarted_node_is_set_again(peer: Peer) -> None:
    with Taker(source()) as taker:
        taker.source.configure(SUDDEN_CW)
        peer.end_node(door_node(peer))
        peer.until(lambda: "not there" in (taker.source.sides_problem or ""))
        door = door_node(peer)
        peer.until(lambda: taker.source.sides_problem is None)
        assert door.get_parameter("opening_side").value == "CW"


def test_a_refused_parameter_is_named(peer: Peer) -> None:
    door_node(peer, read_only="opening_side")
    with Taker(source()) as taker:
        taker.source.configure(SUDDEN_CW)
        peer.until(lambda: "refused" in (taker.source.sides_problem or ""))
        problem = taker.source.sides_problem
        assert problem is not None
        assert problem.startswith("node /madrob/door refused opening_side (")
        assert problem.endswith("): set the opening side by hand")


def test_an_unknown_parameter_is_named(peer: Peer) -> None:
    door_node(peer, without="brake_enabled")
    with Taker(source()) as taker:
        taker.source.configure(SUDDEN_CW)
        peer.until(lambda: "refused brake_enabled" in (taker.source.sides_problem or ""))


@pytest.mark.slow
def test_a_node_that_hangs_is_named_and_asked_again(peer: Peer) -> None:
    deaf = door_node(peer, spun=False)
    with Taker(source()) as taker:
        taker.source.configure(SUDDEN_CW)
        peer.until(lambda: "does not answer" in (taker.source.sides_problem or ""))
        peer.end_node(deaf)
        door_node(peer)
        peer.until(lambda: taker.source.sides_problem is None)


def test_an_answer_without_results_is_no_confirmation(peer: Peer) -> None:
    service = load_module("rcl_interfaces.srv").SetParameters
    peer.node("door").create_service(
        service, "/madrob/door/set_parameters", lambda _, response: response
    )
    with Taker(source()) as taker:
        taker.source.configure(SUDDEN_CW)
        peer.until(lambda: "refused the parameters" in (taker.source.sides_problem or ""))


def _plain(value: object) -> object:
    return value if isinstance(value, str | bool) else list(value)  # type: ignore[call-overload]
