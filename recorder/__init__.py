"""Bytes in, MCAP out.

What the bytes mean is in madrob_console; no ROS is needed to read or write them. What stands in
`__all__` is the interface, and nothing else is:

    from recorder import Bag, BagWriter, RawMessage, Topic, recover

    topic = Topic("/door", "std_msgs/msg/Float64", definition="float64 data")
    with BagWriter(Path("my_bag"), [topic], records={}) as writer:
        writer.put_message(RawMessage(topic.name, topic.type, cdr, publish_ns=now, receive_ns=now))
    recover(Path("my_bag"))  # a bag that was cut off is whole then
    for message in Bag("my_bag").messages():
        print(message.topic, message.receive_ns, len(message.data))
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from recorder.bag import Qos, RawMessage, Topic
    from recorder.reader import Bag
    from recorder.recovery import Recovered, recover
    from recorder.writer import BagWriter

__all__ = [
    "Bag",
    "BagWriter",
    "Qos",
    "RawMessage",
    "RecorderError",
    "Recovered",
    "Topic",
    "recover",
]


class RecorderError(Exception):
    """A bag cannot be written or read; the message names it and the remedy."""


_MODULES = {
    "Bag": "reader",
    "BagWriter": "writer",
    "Qos": "bag",
    "RawMessage": "bag",
    "Recovered": "recovery",
    "Topic": "bag",
    "recover": "recovery",
}


def __getattr__(name: str) -> Any:  # noqa: ANN401  whatever is asked for
    """Import what is asked for, so that no help text waits for it."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
