"""Sets the testbed's sides and brake over its parameter service (protocol section 3)."""

from __future__ import annotations

import time

from madrob_console.testbeds.ros.connection import RosObject, in_namespace, load_module
from scoring.protocol import Condition, Side
from scoring.run_info import braking_table, door_controller_mode

DOOR_NODE = "/madrob/door"

SET_PARAMETERS = f"{DOOR_NODE}/set_parameters"

_PATIENCE = 2.0
"""Seconds after which an unanswered request is sent again."""

_BY_HAND = "set the opening side by hand"

ParameterValue = str | bool | list[int]
_Request = dict[str, ParameterValue]


def door_parameters(condition: Condition) -> _Request:
    """The parameters of the node `/madrob/door` for a condition, by name.

    The braking tables hold 181 forces in gram-force for -90..+90 deg.
    """
    benchmark_type = condition.benchmark_type
    return {
        "opening_side": condition.opening_side.upper(),
        "benchmark_type": benchmark_type.value,
        "brake_enabled": door_controller_mode(benchmark_type) != 0,
        "brake_lut_cw": list(braking_table(benchmark_type, Side.CW)),
        "brake_lut_ccw": list(braking_table(benchmark_type, Side.CCW)),
    }


class DoorParameters:
    """Sets the parameters of the node `/madrob/door`, whenever it is there.

    `request` and `problem` may be called from any thread and never wait; `poll` belongs to the
    thread that spins the node.
    """

    def __init__(self, node: RosObject) -> None:
        self._service = load_module("rcl_interfaces.srv").SetParameters
        self._client = node.create_client(self._service, in_namespace(SET_PARAMETERS))
        # requests are compared by identity: an equal one later is another one
        self._wanted: _Request | None = None
        self._answer: tuple[_Request, str | None] | None = None
        self._asked: _Request | None = None
        self._asked_at = 0.0
        self._future: RosObject = None

    def request(self, condition: Condition) -> None:
        self._wanted = door_parameters(condition)

    @property
    def problem(self) -> str | None:
        """Why the sides must be set by hand; None once the node has confirmed them."""
        wanted, answer = self._wanted, self._answer
        if wanted is None:
            return "the testbed's sides are not set yet: set up a run"
        if answer is not None and answer[0] is wanted:
            return answer[1]
        return f"node {DOOR_NODE} has not confirmed the sides yet"

    @property
    def pending(self) -> bool:
        return self._future is not None

    def poll(self) -> None:
        """Sends the request or checks for the answer; call it a few times a second."""
        wanted = self._wanted
        if wanted is None:
            return
        if not self._client.service_is_ready():
            self._drop_request()
            self._answer = (wanted, f"node {DOOR_NODE} is not there: {_BY_HAND}")
        elif wanted is not self._asked:
            self._ask(wanted)
        elif self._future is not None and self._future.done():
            self._answer = (wanted, _judgement(wanted, self._future.result()))
            self._future = None
        elif self._future is not None and time.monotonic() - self._asked_at > _PATIENCE:
            self._answer = (wanted, f"node {DOOR_NODE} does not answer: {_BY_HAND}")
            self._ask(wanted)

    def _ask(self, wanted: _Request) -> None:
        self._drop_request()
        request = self._service.Request(
            parameters=[_parameter(name, value) for name, value in wanted.items()]
        )
        self._future = self._client.call_async(request)
        self._asked, self._asked_at = wanted, time.monotonic()

    def _drop_request(self) -> None:
        if self._future is not None:
            self._client.remove_pending_request(self._future)
        self._future = self._asked = None


def _parameter(name: str, value: ParameterValue) -> RosObject:
    parameter = load_module("rclpy.parameter").Parameter
    return parameter(name, value=value).to_parameter_msg()


def _judgement(wanted: _Request, response: RosObject) -> str | None:
    refused = [
        f"{name} ({result.reason or 'no reason given'})"
        for name, result in zip(wanted, response.results, strict=False)
        if not result.successful
    ]
    if not refused and len(response.results) == len(wanted):
        return None
    return f"node {DOOR_NODE} refused {', '.join(refused) or 'the parameters'}: {_BY_HAND}"
