"""What the messages of a topic are made of, by this system or by the one that publishes them."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from madrob_console.testbeds.ros.definitions import Definition, find_definition, joined
from madrob_console.testbeds.ros.loading import RosObject, load_module

PATIENCE = 2.0
"""Who publishes a type has so long to tell what it is made of, s."""

_SERVICE = "type_description_interfaces.srv"
_LARGEST = 256_000
"""Characters of a definition; more is none."""


@dataclass(slots=True)
class _Asked:
    client: RosObject  # None = nobody yet, for who publishes it has no name
    until: float
    future: RosObject = None


class TypeWords:
    """Finds definitions of message types: installed ones, else those that a publisher's node has.

    Nodes of ROS 2 tell what their types are made of (`~/get_type_description`). One thread.

    Args:
        node: asks them; something must spin it while `pending`.
        prefixes: where ROS packages are installed.
    """

    def __init__(self, node: RosObject, prefixes: Sequence[Path]) -> None:
        self._node = node
        self._prefixes = prefixes
        self._installed: dict[str, Definition | None] = {}
        self._told: dict[tuple[str, str], Definition] = {}
        self._asked: dict[tuple[str, str], _Asked] = {}

    @property
    def pending(self) -> bool:
        """Whether somebody was asked and has not answered."""
        return bool(self._asked)

    def find(self, type_name: str, type_hash: str, who: str) -> Definition | None:
        """The definition of a type; None while nobody has told. Ask again: it may come.

        Args:
            type_name: `pkg/msg/Type`.
            type_hash: as a publisher says; empty = it does not.
            who: full name of the node that publishes it; empty = not known yet, or not at all.

        Returns:
            One without text where nobody knows.
        """
        if type_name not in self._installed:
            self._installed[type_name] = find_definition(type_name, self._prefixes)
        installed = self._installed[type_name]
        if installed is not None and installed.type_hash in (type_hash, ""):
            return installed
        if installed is not None and not type_hash:
            return installed
        key = (type_name, type_hash)
        if key in self._told:
            return self._told[key]
        if key not in self._asked or (who and self._asked[key].client is None):
            self._ask(key, who)
        if key in self._asked and not self._answered(key, self._asked[key]):
            return None
        return self._told[key]

    def _ask(self, key: tuple[str, str], who: str) -> None:
        try:
            service = load_module(_SERVICE).GetTypeDescription
        except ModuleNotFoundError:
            self._told[key] = Definition("", key[1])
            return
        client = None
        if who:
            client = self._node.create_client(service, f"{who}/get_type_description")
        self._asked[key] = _Asked(client, time.monotonic() + PATIENCE)

    def _answered(self, key: tuple[str, str], asked: _Asked) -> bool:
        """Whether there is an answer, or none is waited for any more."""
        client = asked.client
        if client is not None and asked.future is None and client.service_is_ready():
            kind = client.srv_type
            request = kind.Request(type_name=key[0], type_hash=key[1], include_type_sources=True)
            asked.future = client.call_async(request)
        done = asked.future is not None and asked.future.done()
        if not done and time.monotonic() < asked.until:
            return False
        del self._asked[key]
        answer = asked.future.result() if done else None
        if client is not None:
            self._node.destroy_client(client)
        text = "" if answer is None or not answer.successful else _text(key[0], answer.type_sources)
        self._told[key] = Definition(text, key[1])
        return True


def _text(type_name: str, sources: Iterable[RosObject]) -> str:
    """The definition that a node has told; empty where it is none."""
    told = {str(each.type_name): each for each in sources}
    if type_name not in told or any(each.encoding != "msg" for each in told.values()):
        return ""
    own = str(told.pop(type_name).raw_file_contents)
    text = joined(own, {name: str(each.raw_file_contents) for name, each in told.items()})
    return text if len(text) <= _LARGEST else ""
