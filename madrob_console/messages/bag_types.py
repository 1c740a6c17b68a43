"""The message types of a bag."""

from __future__ import annotations

from functools import cache

from madrob_console.messages.codec import MessageTypes
from recorder.reader import Bag


@cache
def standard_types() -> MessageTypes:
    """The types of ROS 2, for all bags: what reads them is compiled once. Register nothing here."""
    return MessageTypes()


def types_of(bag: Bag) -> MessageTypes:
    """The types of a bag; those that only it knows are registered for it alone.

    Raises:
        MadrobError: the definition of one cannot be read.
    """
    unknown = [topic for topic in bag.topics() if not standard_types().knows(topic.type)]
    if not unknown:
        return standard_types()
    types = MessageTypes()
    for topic in unknown:
        if not types.knows(topic.type):
            types.register(topic.type, topic.definition)
    return types
