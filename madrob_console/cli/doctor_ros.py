"""The doctor's findings about ROS 2 and the testbed's topics, and what libraries print."""

from __future__ import annotations

import ctypes
import fcntl
import importlib.util
import os
import re
import socket
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from functools import partial
from importlib import metadata
from multiprocessing import get_context
from multiprocessing.connection import Connection as Pipe
from pathlib import Path
from tempfile import TemporaryFile

from madrob_console.cli.finding import Finding, Severity
from madrob_console.common.clock import SystemClock, seconds
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import counted
from madrob_console.common.names import terminal_safe
from madrob_console.engine.core.observation import Observation
from madrob_console.messages.fields import find_field
from madrob_console.messages.mapping import STRIPS, TopicMapping
from madrob_console.messages.types import MessageError, MessageTypes
from madrob_console.referee.records import SILENT, FaultKind
from madrob_console.referee.topic_health import SensorLimits
from madrob_console.testbeds.ros import RosSource
from madrob_console.testbeds.ros.connection import (
    REMEDY,
    SEE_DOCTOR,
    SHARED_MEMORY,
    Connection,
    RosObject,
    load_module,
    load_rclpy,
)
from madrob_console.testbeds.ros.door_parameters import DOOR_NODE, SET_PARAMETERS
from madrob_console.testbeds.ros.intake import Intake
from madrob_console.testbeds.ros.types import describe_registered, prefixes
from madrob_console.testbeds.ros_domain import domain_id
from madrob_console.testbeds.source import TopicStatus
from scoring.protocol import Signal, Thresholds

MOST_LINES = 5

_LARGEST = 1 << 20
_STREAMS = (1, 2)  # standard output and error output
_DATE = re.compile(r"^[0-9-]{10} [0-9:.]+ ")
_PLACE = re.compile(r" -> Function \w+$")


@contextmanager
def overheard() -> Iterator[list[str]]:
    """Keep the output of libraries from the terminal while inside.

    Yields a list that holds the lines afterwards, each once, without their times: what a library
    prints ten times a second is one line.
    """
    lines: list[str] = []
    with TemporaryFile() as file:
        _flush()
        kept = [os.dup(stream) for stream in _STREAMS]
        for stream in _STREAMS:
            os.dup2(file.fileno(), stream)
        try:
            yield lines
        finally:
            _flush()
            for stream, copy in zip(_STREAMS, kept, strict=True):
                os.dup2(copy, stream)
                os.close(copy)
        file.seek(0)
        said = file.read(_LARGEST).decode(errors="replace").splitlines()
        lines += [line for line in dict.fromkeys(map(_plain, said)) if line][:MOST_LINES]


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    ctypes.CDLL(None).fflush(None)  # and what C has not written yet


def _plain(line: str) -> str:
    return _PLACE.sub("", _DATE.sub("", terminal_safe(line))).strip()


def in_child(
    subject: str, look: Callable[..., Iterable[Finding]], *arguments: object
) -> Iterator[Finding]:
    """Collect what a look at ROS finds, in a process of its own: ROS may end it.

    Where ROS does, that is an error about `subject`. What libraries print is a finding, too.
    """
    context = get_context("spawn")  # a fork would copy the threads of ROS
    ours, theirs = context.Pipe(duplex=False)
    child = context.Process(target=_report, args=(theirs, look, arguments), daemon=True)
    with overheard() as lines:
        child.start()
        theirs.close()
        try:
            found = ours.recv()
        except EOFError:
            found = None
        child.join()
    if found is None:
        words = f"ROS ended the program that tried it (exit code {child.exitcode})"
        found = [Finding(Severity.ERROR, subject, words)]
    yield from found
    yield from (Finding(Severity.WARNING, "ros says", line) for line in lines)


def _report(
    pipe: Pipe[object, object],
    look: Callable[..., Iterable[Finding]],
    arguments: Sequence[object],
) -> None:
    pipe.send(list(look(*arguments)))


SYSTEM_ROS = Path("/opt/ros")
_WHEELS = "ros-jazzy-rclpy"
_DISCOVERY = 7.0
"""Timeout of discovery, s; it ends sooner if everything is found.

What is lost at first is said again each 3 s.
"""


def look_at_ros(
    mappings: Sequence[TopicMapping],
    domain: int | None,
    listen: float,
    environment: Mapping[str, str],
) -> Iterator[Finding]:
    yield from look_at_installation(environment)
    try:
        number = domain_id(domain, environment)
    except MadrobError as error:
        yield Finding(Severity.ERROR, "ros domain", str(error))
        return
    yield Finding(Severity.OK, "ros domain", str(number))
    yield _discovery(environment)
    if importlib.util.find_spec("rclpy") is None:
        return
    yield from in_child("ros", _look_inside, mappings, number, listen, dict(environment))


def _look_inside(
    mappings: Sequence[TopicMapping],
    number: int,
    listen: float,
    environment: Mapping[str, str],
) -> Iterator[Finding]:
    try:
        load_rclpy()
        if listen > 0:
            yield from look_at_testbed(mappings, number, listen, environment)
    except MadrobError as error:
        yield Finding(Severity.ERROR, "ros", str(error).removesuffix(SEE_DOCTOR))


def look_at_installation(
    environment: Mapping[str, str], system: Path = SYSTEM_ROS
) -> Iterator[Finding]:
    distributions = sorted(path.name for path in system.glob("*/") if (path / "share").is_dir())
    try:
        wheels = metadata.version(_WHEELS)
    except metadata.PackageNotFoundError:
        wheels = None
    spec = importlib.util.find_spec("rclpy")
    if spec is None:
        hint = f"{system}/{distributions[-1]} is not sourced; " if distributions else ""
        yield Finding(Severity.WARNING, "ros", f"not found, {hint}only simulated: {REMEDY}")
        return
    where = Path(spec.origin or "").parent
    distribution = environment.get("ROS_DISTRO") or "jazzy"
    kind = "system" if where.is_relative_to(system) or not wheels else f"wheels {wheels}"
    yield Finding(Severity.OK, "ros", f"{distribution}, {kind}, {where}")
    if distributions and wheels:
        yield Finding(
            Severity.WARNING,
            "ros",
            f"both {system}/{distributions[-1]} and wheels are installed, their libraries clash: "
            f"use an environment without {_WHEELS}",
        )


def look_at_testbed(
    mappings: Sequence[TopicMapping],
    domain: int,
    listen: float,
    environment: Mapping[str, str],
) -> Iterator[Finding]:
    """Listen to every configured topic for `listen` s."""
    needed = {m.topic for m in mappings if not m.signal.optional}
    signals = {m.topic: m.signal.value for m in mappings}
    types = MessageTypes()
    source = RosSource(
        mappings, types, SystemClock(), domain, speaks=False, environment=environment
    )
    connection = Connection(domain)
    try:
        source.open()
        node = connection.node("doctor")
        door = node.create_client(load_module("rcl_interfaces.srv").SetParameters, SET_PARAMETERS)
        ends = time.monotonic() + _DISCOVERY
        while time.monotonic() < ends and not (
            door.service_is_ready() and _all_matched(source, needed)
        ):
            source.take_messages(0.05)
        found = any(status.publishers for status in source.status())
        observed = Observation(mappings, Thresholds(), SensorLimits(), types)
        _listen(source, listen if found else 0.0, observed)
        statuses = source.status()
        now = seconds(SystemClock().now_ns())
        counts = {view.topic: view.received for view in observed.sensors.topics(statuses, {}, now)}
        faults = observed.sensors.faults(statuses, now)
        has_door = door.service_is_ready()
        heard = {status.topic for status in statuses if status.publishers}
        proposed = tuple(_proposals(mappings, heard, node, types, environment))
        console, robot = source.other_referee, source.robot_problems
    finally:
        source.close()
        connection.close()
    silent = any(status.publishers and not counts[status.topic] for status in statuses)
    users = other_users() if silent else ""
    start = "start the testbed"
    if server := environment.get("ROS_DISCOVERY_SERVER"):
        start += f", or correct ROS_DISCOVERY_SERVER={terminal_safe(server)}"
    look = "see `other user`" if users else "look at its sensor"
    for status in statuses:
        rate = counts[status.topic] / listen
        signal = signals[status.topic]
        silence = faults.get((signal, FaultKind.NEVER_SEEN), SILENT)
        yield _topic(
            status,
            rate,
            start,
            f"{silence}: {look}",
            optional=status.topic not in needed,
            several=(signal, FaultKind.SEVERAL_PUBLISHERS) in faults,
        )
        for kind in (FaultKind.UNREADABLE, FaultKind.NO_READING):
            if words := faults.get((signal, kind)):
                words = words.partition(" messages: ")[2]
                yield Finding(Severity.WARNING, status.topic, words)
    if users:
        words = (
            f"{users} runs ROS here, too, and users do not hear each other: set ROS_AUTOMATIC_"
            "DISCOVERY_RANGE=SUBNET and FASTDDS_BUILTIN_TRANSPORTS=UDPv4 on both sides"
        )
        yield Finding(Severity.WARNING, "other user", words)
    yield from proposed
    yield from (Finding(Severity.WARNING, topic, words) for topic, words in robot.items())
    yield _door(present=has_door)
    if console is not None:
        yield Finding(Severity.WARNING, "console", f"one runs in domain {domain}: {console}")


def _all_matched(source: RosSource, topics: set[str]) -> bool:
    return all(status.publishers for status in source.status() if status.topic in topics)


def _listen(source: RosSource, duration: float, observed: Observation) -> None:
    ends = time.monotonic() + duration
    while (left := ends - time.monotonic()) > 0:
        for message in source.take_messages(left):
            observed.receive(message, recorded=False, shown=True)


_JOINT = "position[name=door]"
_LIKELY = {
    Signal.DOOR: (_JOINT, "angle"),
    Signal.HANDLE: ("wrench.force.x", "force.x", "force"),
    **dict.fromkeys(STRIPS, ("ranges", "ranges.range", "range")),
}
"""Fields in messages of other testbeds."""

_OVERHEARS, _PERIOD = 1.0, 0.02
_MOST_NAMES, _LONGEST_NAME = 6, 40


def _proposals(
    mappings: Sequence[TopicMapping],
    heard: Collection[str],
    node: RosObject,
    types: MessageTypes,
    environment: Mapping[str, str],
) -> Iterator[Finding]:
    """Topics that are not `heard`, and their field that may carry a signal that is not, either."""
    describe = partial(describe_registered, types, prefixes(environment))
    missing = [mapping.signal for mapping in mappings if mapping.topic not in heard]
    paths = dict.fromkeys(path for signal in missing for path in _LIKELY.get(signal, ()))
    for topic, (type_name, *_) in node.get_topic_names_and_types() if paths else ():
        for path in paths if topic not in heard else ():
            with suppress(MadrobError):  # the type is not installed here, or has no such field
                describe(topic, type_name)
                find_field(types, type_name, path)
                names = _names(Intake(node, topic, describe), types) if path == _JOINT else []
                field = path.replace("door", "...") if names and "door" not in names else path
                has = ", ".join(names) or type_name
                words = terminal_safe(f"has {has}: {field}?")
                yield Finding(Severity.WARNING, terminal_safe(topic), words)
                break


def _names(joints: Intake, types: MessageTypes) -> list[str]:
    """Names of the joints, from the first message."""
    ends = time.monotonic() + _OVERHEARS
    with closing(joints), suppress(MessageError):
        while time.monotonic() < ends:
            joints.discover()
            for one in joints.take_messages(1):
                names = types.decode(joints.type, one.data).name[:_MOST_NAMES]
                return [name[:_LONGEST_NAME] for name in names]
            time.sleep(_PERIOD)
    return []


def other_users(folder: Path = SHARED_MEMORY) -> str:
    """The other users whose programs hold shared memory of Fast DDS now."""
    users: set[str] = set()
    for lock in folder.glob("fastrtps_*_el"):
        with suppress(FileNotFoundError, KeyError):
            try:
                with lock.open() as file:
                    fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except (BlockingIOError, PermissionError):  # else it is left of a killed program
                if lock.stat().st_uid != os.geteuid():
                    users.add(lock.owner())
    return ", ".join(sorted(users))


def _topic(
    status: TopicStatus, rate: float, start: str, silence: str, *, optional: bool, several: bool
) -> Finding:
    """`start` is the remedy where nobody publishes, `silence` is for where nothing comes."""
    if status.problem is not None:
        return Finding(Severity.WARNING, status.topic, status.problem)
    if status.publishers == 0:
        if optional:
            return Finding(Severity.OK, status.topic, "no publisher (optional)")
        return Finding(Severity.WARNING, status.topic, f"no publisher: {start}")
    found = f"{counted(status.publishers, 'publisher')}, {status.type}"
    if rate == 0 and not optional:
        return Finding(Severity.WARNING, status.topic, f"{found}, but {silence}")
    if several:
        return Finding(Severity.WARNING, status.topic, f"{found}, {rate:.1f} Hz: stop all but one")
    return Finding(Severity.OK, status.topic, f"{found}, {rate:.1f} Hz")


def _door(*, present: bool) -> Finding:
    if present:
        return Finding(Severity.OK, DOOR_NODE, "takes the sides and the brake")
    return Finding(Severity.WARNING, DOOR_NODE, "not there: the sides must be set by hand")


def _discovery(environment: Mapping[str, str]) -> Finding:
    given = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE") or "SUBNET"
    if _hears_itself():
        return Finding(Severity.OK, "discovery", given)
    remedy = "this machine does not hear itself: `ip link set lo up`"
    return Finding(Severity.ERROR, "discovery", f"{given}: {remedy}")


def _hears_itself() -> bool:
    """Over the loopback, by which processes of one machine talk DDS."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
        own.settimeout(1.0)
        try:
            own.bind(("127.0.0.1", 0))
            own.sendto(b"madrob", own.getsockname())
            return own.recv(6) == b"madrob"
        except OSError:
            return False
