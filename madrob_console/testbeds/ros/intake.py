"""The messages of one topic of a ROS domain: taken as bytes, losses counted."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TypeAlias

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe
from madrob_console.testbeds.ros.connection import RosObject, in_namespace
from madrob_console.testbeds.ros.subscriptions import (
    QUEUE_DEPTH,
    QosSwitch,
    Received,
    offered_by_all,
)
from recorder.bag import Topic


class LossCounter:
    """Gaps in the sequence numbers of a topic's only publisher.

    With several publishers the loss is unknown, until one is left.
    """

    def __init__(self) -> None:
        self._lost = 0
        self._last: int | None = None
        self._several = False
        self._numbered = True

    @property
    def lost(self) -> int | None:
        return None if self._several or not self._numbered else self._lost

    def restart(self) -> None:
        self._last = None

    def see(self, numbers: Iterable[int | None], publishers: int) -> None:
        """Counts the messages of one take, in the order of arrival.

        `publishers` is the largest number that was matched during the take.
        """
        self._several = publishers > 1
        if not self._several:
            last = self._last
            for number in numbers:
                if number is None:
                    self._numbered = False
                elif last is None or number > last:
                    self._lost += 0 if last is None else number - last - 1
                    last = number
            self._last = last
        if publishers != 1:
            self.restart()


_IN_ORDER = 100
"""So many messages with increasing numbers are of one publisher: 2 s of a sensor."""

DescribeTopic: TypeAlias = Callable[[str, str], tuple[RosObject, Topic]]
"""(topic, type) -> the class of the messages and what a bag says of the topic.

It raises MadrobError with the remedy where the topic cannot be taken.
"""


class Intake:
    """One topic of a ROS domain, of any type, from its discovery on.

    It subscribes when the first publisher appears, with the quality of service that all publishers
    offer: what they keep for late joiners comes, too. Without a `type_name` the topic has the type
    of the publisher that is found first. `remedy` is for another one. After `close` a discovery
    subscribes again. One thread; any may read.

    Attributes:
        topic: what a bag says of the topic; None as long as it is not known, or unusable.
        found_type: the type of what is published; `type` where nothing is.
        publishers: those that were matched at the last take, without those that do not send.
    """

    def __init__(
        self,
        node: RosObject,
        name: str,
        describe: DescribeTopic,
        type_name: str = "",
        *,
        depth: int = QUEUE_DEPTH,
        remedy: str = "correct the settings",
    ) -> None:
        self.name = name
        self.type = type_name
        self.depth = depth
        self._remedy = remedy
        self._node = node
        self._describe = describe
        self._class: RosObject = None
        self._configured = bool(type_name)
        self._losses = LossCounter()
        self.topic: Topic | None = None
        self._switch: QosSwitch | None = None
        self.found_type = type_name
        self._unusable: str | None = None
        self._problem: str | None = None
        self.publishers = self._newest = self._in_order = 0
        self._publisher_ids: frozenset[bytes] = frozenset()
        if type_name:
            self._prepare()

    @property
    def lost(self) -> int | None:
        """Messages lost by the sequence numbers of the publisher; None = unknown."""
        return self._losses.lost

    @property
    def reported_lost(self) -> int:
        """Messages lost according to DDS since the subscription; 0 where it does not tell."""
        return 0 if self._switch is None else self._switch.inbox.reported_lost

    @property
    def problem(self) -> str | None:
        """Why no message, or not every publisher's, can be taken."""
        return self._unusable or self._problem

    def discover(self) -> None:
        """Looks at the publishers and subscribes as they need it; call it a few times a second."""
        infos = self._node.get_publishers_info_by_topic(in_namespace(self.name))
        if infos and not self.type:
            self.type = str(infos[0].topic_type)
            self._prepare()
        usable = [i for i in infos if i.topic_type == self.type and self._same_version(i)]
        misfits = [i for i in infos if i not in usable]
        self._problem = self._misfit(misfits[0], alone=not usable) if misfits else None
        self.found_type = self.type if usable or not infos else str(infos[0].topic_type)
        ids = frozenset(bytes(i.endpoint_gid) for i in usable)
        if ids.isdisjoint(self._publisher_ids):
            self._losses.restart()
        if ids:
            self._publisher_ids = ids
        if not usable or self.topic is None:
            return
        qos = offered_by_all([i.qos_profile for i in usable])
        if self._switch is None:
            self._switch = QosSwitch(self._node, self.name, self._class, qos, self.depth)
        self._switch.forget_delivered()
        self._switch.listen(qos, len(usable))
        if self._switch.inbox.qos == qos != self.topic.qos:
            self.topic = replace(self.topic, qos=qos)

    def take_messages(self, most: int | None = None) -> list[Received]:
        """What has arrived, at most so many messages; DDS keeps `depth` of the others."""
        if self._switch is None:
            return []
        before = self.publishers
        received = self._switch.take_messages(most)
        self.publishers = self._senders(received, self._switch.inbox.publishers)
        self._losses.see((r.sequence for r in received), max(before, self.publishers))
        return received

    def _senders(self, received: Iterable[Received], matched: int) -> int:
        """For 20 s DDS takes a killed publisher for alive; numbers in order are one's alone."""
        for number in (one.sequence or 0 for one in received):
            self._in_order = self._in_order + 1 if number > self._newest else 0
            self._newest = number
        return min(matched, 1) if self._in_order > _IN_ORDER else matched

    def close(self) -> None:
        if self._switch is not None:
            self._switch.close()
            self._switch = None
        self._losses.restart()

    def _prepare(self) -> None:
        try:
            self._class, self.topic = self._describe(self.name, self.type)
        except MadrobError as error:
            self._unusable = str(error)

    def _same_version(self, info: RosObject) -> bool:
        """Whether publisher and console have the same fields in the type, as far as both tell."""
        ours = "" if self.topic is None else self.topic.type_hash
        theirs = str(info.topic_type_hash)
        return not ours or not theirs.startswith("RIHS") or theirs == ours

    def _misfit(self, info: RosObject, *, alone: bool) -> str:
        found = terminal_safe(str(info.topic_type))[:80]
        if not alone:
            other = "another version of it" if info.topic_type == self.type else found
            return f"another publisher sends {other}: stop that one"
        if info.topic_type == self.type:
            return (
                f"its publisher has another version of {found}: "
                "install the same version of the package on both machines"
            )
        if self._configured:
            return f"its type is {found}, not {self.type}: {self._remedy}"
        return f"its type has become {found}: not recorded before the next run"
