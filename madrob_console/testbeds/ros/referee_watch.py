"""Who else tells the testbed of a ROS domain where the run stands."""

from __future__ import annotations

import hashlib
import os
import re
import socket
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from madrob_console.messages.codec import REFEREE_STATE_TOPIC
from madrob_console.names import terminal_safe
from madrob_console.testbeds.ros.connection import in_namespace
from madrob_console.testbeds.ros.loading import RosObject

_OURS = re.compile(r"console_(?P<host>\w+)_(?P<pid>\d+)_(?P<machine>[0-9a-f]{6})", re.ASCII)
NAMELESS = ("_NODE_NAME_UNKNOWN_", "_CREATED_BY_BARE_DDS_APP_", "")
"""So ROS calls publishers of which it has not heard whose they are, or that are none of ROS."""

_REMEDY = "end it, or use another ROS domain"


@cache
def console_name() -> str:
    """The name of this process's node: unlike any other's, it says host and process."""
    host = re.sub(r"\W", "_", socket.gethostname(), flags=re.ASCII)[:40] or "host"
    return f"console_{host}_{os.getpid()}_{_machine()}"


def _machine() -> str:
    """What tells this machine, since it was started, and this container from all others."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text()
        processes = str(Path("/proc/self/ns/pid").stat().st_ino)
    except OSError:
        boot, processes = os.urandom(8).hex(), ""  # nothing is known: like no other
    return hashlib.blake2s((boot + processes).encode(), digest_size=3).hexdigest()


class RefereeWatch:
    """Looks for publishers of `/madrob/referee/state` beside this process's own one.

    Args:
        node: asks the ROS graph.
        speaks: whether this process publishes it, too.

    Attributes:
        other: who else does, in words; None = nobody. May be read from any thread.
    """

    def __init__(self, node: RosObject, *, speaks: bool) -> None:
        self.other: str | None = None
        self._node = node
        self._name = node.get_name()
        self._own = int(speaks)

    def look(self) -> None:
        """Ask the graph; call it a few times a second."""
        infos = self._node.get_publishers_info_by_topic(in_namespace(REFEREE_STATE_TOPIC))
        nodes = ((i.node_namespace, i.node_name) for i in infos)
        self.other = second_referee(nodes, self._own, self._name)


def second_referee(
    nodes: Iterable[tuple[str, str]], own: int = 1, own_name: str | None = None
) -> str | None:
    """Who publishes the state of the run beside us, in words; None = nobody.

    One that was killed stays in the graph for a while (20 s with Fast DDS): where it ran on this
    machine, it is known to be gone.

    Args:
        nodes: (namespace, name) of each publisher's node.
        own: how many publishers are ours.
        own_name: of our node; None = `console_name()`.
    """
    others, ours = [], 0
    own_name = own_name or console_name()
    for namespace, name in nodes:
        ours += name == own_name
        if not (name == own_name and ours <= own) and not _is_gone(name):
            others.append(_in_words(namespace, name))
    if not others:
        return None
    who = ", ".join(sorted(others)[:3])
    verb = "publishes" if len(others) == 1 else "publish"
    return f"{who} {verb} {REFEREE_STATE_TOPIC}: {_REMEDY}"


def _is_gone(name: str) -> bool:
    found = _OURS.fullmatch(name)
    if found is None or found["machine"] != _machine():
        return False
    try:
        os.kill(int(found["pid"]), 0)
    except (ProcessLookupError, OverflowError):
        return True
    except PermissionError:  # another user's
        return False
    return False


def _in_words(namespace: str, name: str) -> str:
    if name in NAMELESS:
        return "a program that has not told its name"  # yet: names come after publishers
    full = terminal_safe(f"{namespace.rstrip('/')}/{name}")[:100]
    found = _OURS.fullmatch(name)
    return full if found is None else f"{full} (pid {found['pid']} on {found['host']})"
