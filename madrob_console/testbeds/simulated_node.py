"""The simulated testbed as a ROS 2 node: what a console sees as a live testbed."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

from msgspec import structs

from madrob_console.common.clock import SystemClock
from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import REFEREE_START_POSE_TOPIC, REFEREE_STATE_TOPIC, encode_text
from madrob_console.messages.mapping import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.messages.types import MessageTypes
from madrob_console.testbeds.announcement import INFO_TOPIC, INFO_TYPE, info_text
from madrob_console.testbeds.ros.connection import (
    Connection,
    RosObject,
    in_namespace,
    load_message_class,
    load_module,
)
from madrob_console.testbeds.ros.door_parameters import ParameterValue, door_parameters
from madrob_console.testbeds.ros.subscriptions import qos_profile
from madrob_console.testbeds.ros_domain import domain_id
from madrob_console.testbeds.simulated import SimulatedTestbed
from madrob_console.testbeds.simulated.simulated_source import SimulatedSource
from madrob_console.testbeds.simulated.testbed import RefereeState, parse_state
from recorder.bag import Durability, Qos
from scoring.protocol import BenchmarkType, Condition, Side

_PERIOD = 0.005
"""Seconds between two checks of what is due."""

_POST_ROLL = 3.0
"""Seconds that the node stays after its last run, unless the referee goes on before."""

_NEVER = 1e9
"""Seconds: the start of a robot that only waits."""

_LATE = 1.0
"""Seconds; a robot that hears of its start later sets out at that moment."""

_KEPT = Qos(durability=Durability.TRANSIENT_LOCAL)
_DEFAULT_CONDITION = Condition(BenchmarkType.NO_FORCE, Side.CCW, Side.CCW)

Say = Callable[[str], None]


def serve_testbed(  # noqa: PLR0913  what is played where, and how
    testbed: SimulatedTestbed,
    condition: Condition | None,
    repeat: int,
    *,
    say: Say,
    domain: int | None = None,
    mappings: Sequence[TopicMapping] = DEFAULT_MAPPINGS,
    ros_args: Sequence[str] = (),
    stop: threading.Event | None = None,
) -> None:
    """Runs the testbed until its runs are over, a signal arrives or `stop` is set.

    With `condition` None each run draws one, until the referee sets one. `repeat` is the number of
    runs; 0 = no end. `ros_args` are a launch file's arguments. Another thread may set `stop`.
    """
    number = domain_id(domain, os.environ)
    ended = stop or threading.Event()
    source = SimulatedSource(testbed, SystemClock(), MessageTypes(), mappings)
    connection = Connection(number, ros_args)
    try:
        node = DoorNode(connection, source, condition, say)
        with _noting_signals() as signals:
            say(
                f"simulated testbed {testbed.scenario} in ROS domain {number}: "
                "waits for the referee; every run on it is practice"
            )
            while not (signals or ended.is_set() or (repeat and node.has_done(repeat))):
                connection.spin(_PERIOD)
                node.publish()
        for topic, count in node.published.items():
            say(f"{count} messages on {topic}")
    finally:
        connection.close()


class DoorNode:
    """The node `/madrob/door`: the testbed's topics, its parameters and its robot.

    The caller spins `connection`. `condition` is the first one; None = each run draws one.
    """

    def __init__(
        self, connection: Connection, source: SimulatedSource, condition: Condition | None, say: Say
    ) -> None:
        self.published: Counter[str] = Counter()
        self._source = source
        self._say = say
        self._condition = condition or _DEFAULT_CONDITION
        self._phase = ""
        self._start: float | None = None
        self._runs = 0
        self._over_at = 0.0
        if condition is not None:
            source.configure(condition)
        self._node = connection.node("door", parameter_services=True)
        for name, value in door_parameters(self._condition).items():
            self._declare(name, value)
        self._node.add_on_set_parameters_callback(self._on_parameters)
        self._publishers = {
            topic.topic: self._node.create_publisher(
                load_message_class(topic.type), in_namespace(topic.topic), qos_profile(Qos(), 100)
            )
            for topic in source.status()
        }
        self._listen(REFEREE_STATE_TOPIC, "std_msgs/msg/String", self._on_state)
        self._listen(REFEREE_START_POSE_TOPIC, "geometry_msgs/msg/PoseStamped", self._on_pose)
        source.open()
        self._announce(source)

    def _declare(self, name: str, value: ParameterValue) -> None:
        """Declares a parameter, which ROS arguments may set; MadrobError where they are wrong."""
        try:
            given = self._node.declare_parameter(name, value).value
        except load_module("rclpy.exceptions").ParameterException as error:
            raise MadrobError(f"parameter {name}: {error}") from None
        if (wrong := refusal(name, given)) is not None:
            raise MadrobError(f"parameter {name}: {wrong}")
        if given != value and not name.startswith("brake"):
            self._set(name, given)

    def _announce(self, source: SimulatedSource) -> None:
        text = encode_text(MessageTypes(), info_text(source.testbed.scenario))
        self._keep_saying(INFO_TOPIC, INFO_TYPE, text)

    def _keep_saying(self, topic: str, type_name: str, data: bytes) -> None:
        """Publishes a message that late joiners get, too."""
        message_class, qos = load_message_class(type_name), qos_profile(_KEPT, 1)
        publisher = self._node.create_publisher(message_class, in_namespace(topic), qos)
        publisher.publish(data)

    def has_done(self, runs: int) -> bool:
        if self._runs < runs or self._phase == "running":
            return False
        return self._phase != "stopped" or time.monotonic() > self._over_at + _POST_ROLL

    def publish(self) -> None:
        for message in self._source.take_messages(0):
            self._publishers[message.topic].publish(message.data)
            self.published[message.topic] += 1

    def _listen(self, topic: str, type_name: str, heard: Callable[[RosObject], None]) -> None:
        self._node.create_subscription(
            load_message_class(type_name), in_namespace(topic), heard, qos_profile(_KEPT, 10)
        )

    def _on_parameters(self, parameters: Sequence[RosObject]) -> RosObject:
        result = load_module("rcl_interfaces.msg").SetParametersResult
        for parameter in parameters:
            reason = refusal(parameter.name, parameter.value)
            if reason is not None:
                return result(successful=False, reason=reason)
        for parameter in parameters:
            self._set(parameter.name, parameter.value)
        return result(successful=True)

    def _set(self, name: str, value: ParameterValue) -> None:
        before = self._condition
        if name == "opening_side":
            self._condition = replace(before, opening_side=Side(str(value).lower()))
        elif name == "benchmark_type":
            self._condition = replace(before, benchmark_type=BenchmarkType(str(value)))
        self._source.configure(self._condition)
        if self._condition != before:
            self._say(f"{name.replace('_', ' ')} set to {value}")

    def _on_pose(self, message: RosObject) -> None:
        self._source.testbed.start_distance = abs(message.pose.position.x)

    def _on_state(self, message: RosObject) -> None:
        try:
            state = parse_state(message.data)
        except MadrobError as error:
            self._say(str(error))
            return
        before, self._phase = self._phase, state.phase
        self._start = self._start_of(state, before)
        if state.condition is not None and state.condition != self._condition:
            self._condition = condition = state.condition
            self._say(
                f"condition {condition.number}: {condition.benchmark_type}, opens to "
                f"{condition.opening_side.upper()}, robot on {condition.starting_side.upper()}"
            )
        self._source.heed(structs.replace(state, start_time=self._start))
        if state.phase == "running" != before:
            self._say("robot sets out")
        elif before == "running" != state.phase:
            self._runs += 1
            self._over_at = time.monotonic()
            self._say("run over")

    def _start_of(self, state: RefereeState, before: str) -> float | None:
        """When the robot sets out, s since the epoch; None outside a run.

        The start is unknown during the countdown: the robot takes its place and waits.
        """
        if state.phase == "countdown":
            return _NEVER + time.time()
        if state.phase != "running":
            return None
        if before == "running":
            return self._start
        now = time.time()
        due = state.start_time
        return due if due is not None and abs(now - due) < _LATE else now


def refusal(name: str, value: ParameterValue) -> str | None:
    if name == "opening_side" and value not in ("CW", "CCW"):
        return f"{value!r} is neither CW nor CCW"
    if name == "benchmark_type" and value not in {b.value for b in BenchmarkType}:
        return f"{value!r} is no benchmark type"
    if name.startswith("brake_lut") and isinstance(value, Sequence) and len(value) != 181:
        return f"{len(value)} braking forces instead of 181"
    return None


@contextmanager
def _noting_signals() -> Iterator[Sequence[int]]:
    """SIGINT and SIGTERM are noted instead of killing; in the main thread only.

    The handler takes no lock: a second signal comes while the first one is handled.
    """
    arrived: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield arrived
        return
    signals = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(s, lambda number, _: arrived.append(number)) for s in signals]
    try:
        yield arrived
    finally:
        for number, handler in zip(signals, before, strict=True):
            signal.signal(number, handler)
