"""One configured topic on the wire: found, subscribed and emptied."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from madrob_console.errors import MadrobError
from madrob_console.messages.codec import MessageTypes, describe_topic
from madrob_console.testbeds.ros.connection import in_namespace
from madrob_console.testbeds.ros.definitions import find_definition
from madrob_console.testbeds.ros.handover import Handover
from madrob_console.testbeds.ros.inbox import Received, offered_by_all
from madrob_console.testbeds.ros.loading import RosObject, load_message_class
from madrob_console.testbeds.ros.losses import LossCounter
from madrob_console.testbeds.source import TopicStatus
from recorder.bag import Qos, Topic


class Intake:
    """A testbed topic, from its discovery on. All calls but the properties: one thread.

    Args:
        node: the node that subscribes.
        name: full topic name.
        type_name: the configured message type.
        types: the types known; the configured one is made known here.
        prefixes: where ROS packages are installed.
        direct: see `Inbox`.
    """

    def __init__(
        self,
        node: RosObject,
        name: str,
        type_name: str,
        *,
        types: MessageTypes,
        prefixes: Sequence[Path],
        direct: bool,
    ) -> None:
        self.name = name
        self.type = type_name
        self._node = node
        self._losses = LossCounter()
        self._class: RosObject = None
        self._type_hash = ""
        self._topic: Topic | None = None
        self._found_type = type_name
        self._problem: str | None = None
        self._publishers = 0
        self._publisher_ids: frozenset[bytes] = frozenset()
        self._unusable = self._prepare(types, prefixes)
        self._handover = Handover(node, name, self._class, direct=direct)

    @property
    def topic(self) -> Topic | None:
        """What a bag must know of it; None while its type cannot be used here."""
        return self._topic

    def status(self, dropped: int) -> TopicStatus:
        """Its state; `dropped` messages were lost behind the intake."""
        lost = self._losses.lost
        return TopicStatus(
            topic=self.name,
            type=self._found_type,
            publishers=self._publishers,
            lost=None if lost is None else lost + dropped,
            problem=self._unusable or self._problem,
        )

    def discover(self) -> None:
        """Look at the publishers, and subscribe to them as they need it."""
        infos = self._node.get_publishers_info_by_topic(in_namespace(self.name))
        usable = [i for i in infos if i.topic_type == self.type and self._same_version(i)]
        misfits = [i for i in infos if i not in usable]
        self._problem = self._misfit(misfits[0], alone=not usable) if misfits else None
        self._found_type = self.type if usable or not infos else infos[0].topic_type
        ids = frozenset(bytes(i.endpoint_gid) for i in usable)
        if ids.isdisjoint(self._publisher_ids):
            self._losses.restart()
        if ids:
            self._publisher_ids = ids
        self._handover.settle()
        if usable and not self._unusable:
            self._listen(offered_by_all([i.qos_profile for i in usable]), len(usable))

    def take(self) -> list[Received]:
        """Everything that has arrived since the last call."""
        if self._handover.qos is None:
            return []
        before = self._publishers
        received = self._handover.take()
        self._publishers = self._handover.publishers
        self._losses.see((r.sequence for r in received), max(before, self._publishers))
        return received

    def close(self) -> None:
        """End the subscription."""
        self._handover.close()

    def _prepare(self, types: MessageTypes, prefixes: Sequence[Path]) -> str | None:
        """Find class and definition of the type; returns why it cannot be used."""
        definition = find_definition(self.type, prefixes)
        try:
            self._class = load_message_class(self.type)
            if definition is not None:
                types.register(self.type, definition.text)
                self._type_hash = definition.type_hash
            self._topic = describe_topic(types, self.name, self.type)
        except MadrobError as error:
            return str(error)
        return None

    def _same_version(self, info: RosObject) -> bool:
        """Whether a publisher's type has the fields that ours has, as far as both say so."""
        theirs = str(info.topic_type_hash)
        return not self._type_hash or not theirs.startswith("RIHS") or theirs == self._type_hash

    def _misfit(self, info: RosObject, *, alone: bool) -> str:
        if not alone:
            other = "another version of it" if info.topic_type == self.type else info.topic_type
            return f"another publisher sends {other}: stop that one"
        if info.topic_type == self.type:
            return (
                f"its publisher has another version of {self.type}: "
                "install the same version of the package on both machines"
            )
        return f"its type is {info.topic_type}, not {self.type}: correct the settings"

    def _listen(self, qos: Qos, publishers: int) -> None:
        self._handover.listen(qos, publishers)
        if self._topic is not None and self._handover.qos == qos != self._topic.qos:
            self._topic = replace(self._topic, qos=qos)
