"""What else is heard in a ROS domain: other referees, and the testbed's announcement."""

from __future__ import annotations

import hashlib
import os
import re
import socket
from collections import deque
from collections.abc import Collection, Iterable
from functools import cache
from pathlib import Path

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.messages.codec import REFEREE_STATE_TOPIC, decode_text, describe_topic
from madrob_console.messages.types import MessageTypes
from madrob_console.testbeds.announcement import (
    INFO_TOPIC,
    INFO_TYPE,
    LARGEST_INFO,
    SILENT,
    Announcement,
    simulated_in,
)
from madrob_console.testbeds.ros.connection import RosObject, in_namespace, load_message_class
from madrob_console.testbeds.ros.subscriptions import Inbox, Received
from recorder.bag import Durability, Qos, RawMessage, Topic

_OURS = re.compile(r"console_(?P<host>\w+)_(?P<pid>\d+)_(?P<machine>[0-9a-f]{6})", re.ASCII)
_NAMELESS = ("_NODE_NAME_UNKNOWN_", "_CREATED_BY_BARE_DDS_APP_", "")

_REMEDY = "end it, or use another ROS domain"


@cache
def console_name() -> str:
    """The name of this process's node, unique by host and process."""
    host = re.sub(r"\W", "_", socket.gethostname(), flags=re.ASCII)[:40] or "host"
    return f"console_{host}_{os.getpid()}_{_machine()}"


def _machine() -> str:
    """Identifies this machine since its start, and this container."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text()
        processes = str(Path("/proc/self/ns/pid").stat().st_ino)
    except OSError:
        boot, processes = os.urandom(8).hex(), ""  # nothing is known: like no other
    return hashlib.blake2s((boot + processes).encode(), digest_size=3).hexdigest()


class RefereeWatch:
    """Looks for publishers of `/madrob/referee/state` beside this process's own one.

    Any thread may read `other`: the other referee, in words; None = nobody. `said` are the messages
    of this process: who is dead by name and sends others lives.
    """

    def __init__(self, node: RosObject, listener: RosObject, *, speaks: bool) -> None:
        self.other: str | None = None
        self.said: deque[bytes] = deque(maxlen=2 * _DEPTH)
        self._node = node
        self._name = node.get_name()
        self._own = int(speaks)
        message_class = load_message_class(INFO_TYPE)
        self._inbox = Inbox(listener, message_class, REFEREE_STATE_TOPIC, _LATCHED, depth=_DEPTH)
        self._gone: set[str] = set()
        self._lives = False

    def look_at_graph(self) -> None:
        infos = self._node.get_publishers_info_by_topic(in_namespace(REFEREE_STATE_TOPIC))
        nodes = [(i.node_namespace, i.node_name) for i in infos]
        heard = any(one.data not in self.said for one in self._inbox.take_messages())
        before, self._gone = self._gone, {name for _, name in nodes if _is_gone(name)}
        self._lives = bool(self._gone) and (self._lives or (heard and self._gone <= before))
        gone = set() if self._lives else self._gone
        self.other = second_referee(nodes, gone, self._own, self._name)

    def close(self) -> None:
        self._inbox.close()


def second_referee(
    nodes: Iterable[tuple[str, str]],
    gone: Collection[str] = (),
    own: int = 1,
    own_name: str | None = None,
) -> str | None:
    """The other referee among the publishers' (namespace, name) pairs, in words; None = nobody.

    A killed one stays in the graph for a while (20 s with Fast DDS); one that ran on this machine
    is known to be `gone`. `own` is the number of this process's publishers.
    """
    others, ours = [], 0
    own_name = own_name or console_name()
    for namespace, name in nodes:
        ours += name == own_name
        if not (name == own_name and ours <= own) and name not in gone:
            others.append(_in_words(namespace, name))
    if not others:
        return None
    who = ", ".join(sorted(others)[:3])
    verb = "publishes" if len(others) == 1 else "publish"
    return f"{who} {verb} {REFEREE_STATE_TOPIC}: {_REMEDY}"


def _is_gone(name: str) -> bool:
    """Whether a node's name is that of a process of this machine that has ended."""
    if (found := _OURS.fullmatch(name)) is None or found["machine"] != _machine():
        return False
    return not Path(f"/proc/{found['pid']}").exists()


def _in_words(namespace: str, name: str) -> str:
    if name in _NAMELESS:
        return "a program that has not told its name"  # yet: names come after publishers
    full = terminal_safe(f"{namespace.rstrip('/')}/{name}")[:100]
    found = _OURS.fullmatch(name)
    return full if found is None else f"{full} (pid {found['pid']} on {found['host']})"


_DEPTH = 10
"""Messages that DDS keeps between two looks; more only repeat themselves."""

_LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL)


class InfoWatch:
    """Listens to `/madrob/testbed/info`, which late joiners hear, too.

    An announcement holds as long as a possible publisher is there. Of several testbeds, one that is
    simulated is enough.
    """

    def __init__(self, node: RosObject, types: MessageTypes) -> None:
        self._said = SILENT
        self.topic: Topic = describe_topic(types, INFO_TOPIC, INFO_TYPE, _LATCHED)
        self._types = types
        message_class = load_message_class(INFO_TYPE)
        self._inbox = Inbox(node, message_class, INFO_TOPIC, _LATCHED, depth=_DEPTH)

    @property
    def heard(self) -> Announcement:
        """The announcement. May be read from any thread."""
        return self._said

    def take_info(self) -> None:
        heard = self._inbox.take_messages()
        publishers = self._inbox.publishers
        if not publishers and not heard:
            self._said = SILENT
        for message in heard:
            news = self._understood(message)
            if publishers < 2 or self._said.simulated is None:
                self._said = news

    def close(self) -> None:
        self._inbox.close()

    def _understood(self, received: Received) -> Announcement:
        size = len(received.data)
        if size > LARGEST_INFO:
            return Announcement(problem=f"{size} bytes are no announcement: stop what sends that")
        raw = RawMessage(
            INFO_TOPIC, INFO_TYPE, received.data, received.source_ns, received.received_ns
        )
        try:
            return Announcement(simulated_in(decode_text(self._types, received.data)), None, (raw,))
        except MadrobError as error:
            return Announcement(None, str(error), (raw,))
