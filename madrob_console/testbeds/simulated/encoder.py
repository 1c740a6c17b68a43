"""Readings as messages: the way back through a configured mapping.

Whatever types and units a testbed is configured with, its simulation publishes the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from types import MappingProxyType

import numpy as np

from madrob_console.common.clock import NS
from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import find_signal
from madrob_console.messages.fields import MessageField, attribute, has_header
from madrob_console.messages.mapping import NamedElement, TopicMapping
from madrob_console.messages.types import Message, MessageTypes
from madrob_console.testbeds.simulated.sensor_model import RANGE_MAX, RANGE_MIN, Reading
from scoring.protocol import SENSORS_PER_STRIP


class Encoder:
    """Encodes the messages of one topic, reusing one message object.

    In a scan, `scan` sets the fields beside the ranges. Where the type is unknown, or its field
    cannot hold the signal, it raises MadrobError.
    """

    def __init__(
        self,
        mapping: TopicMapping,
        types: MessageTypes,
        frame: str = "",
        scan: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        self._mapping = mapping
        self._types = types
        field = find_signal(types, mapping)
        self._message = types.make(mapping.type)
        self._stamp = None
        if has_header(types, mapping.type):
            self._stamp = self._message.header.stamp
            self._message.header.frame_id = frame
        self._holder, self._name, self._index = self._place(field)
        self._base = field.base
        if field.numbers:
            size = len(getattr(self._holder, self._name))
            if size not in (0, SENSORS_PER_STRIP):
                raise self._error(f"{mapping.field} holds {size} ranges, not 4")
            self._set_limits(field)
            self._set_beside(field, scan)
        if mapping.type == "sensor_msgs/msg/JointState":
            self._message.name = ["door"]
        if isinstance(named := field.steps[-1], NamedElement):
            setattr(self._holder, named.names, [named.value])

    def encode(self, stamp_ns: int, reading: Reading) -> bytes:
        if self._stamp is not None:
            self._stamp.sec, self._stamp.nanosec = divmod(stamp_ns, NS)
        if isinstance(reading, tuple):
            published = [self._published(number) for number in reading]
            dtype = getattr(self._holder, self._name).dtype
            setattr(self._holder, self._name, np.array(published, dtype))
        elif self._index is None:
            setattr(self._holder, self._name, self._published(reading))
        else:
            getattr(self._holder, self._name)[self._index] = self._published(reading)
        return self._types.encode(self._mapping.type, self._message)

    def _published(self, value: float) -> float:
        raw = (value - self._mapping.offset) / self._mapping.scale
        if self._base.startswith("float"):
            return raw
        return raw >= 0.5 if self._base == "bool" else round(raw)

    def _place(self, field: MessageField) -> tuple[Message, str, int | None]:
        *way, last = field.steps
        index = None
        if not isinstance(last, str):
            index = last if isinstance(last, int) else 0
            *way, last = way
        names = [attribute(step) for step in (*way, last) if isinstance(step, str)]
        if len(names) <= len(way) or field.messages is not None:
            raise self._error(f"{self._mapping.field} leads through an array of messages")
        holder = reduce(getattr, names[:-1], self._message)
        if index is not None:
            array = getattr(holder, names[-1])
            if len(array) <= index:
                setattr(holder, names[-1], np.zeros(index + 1, array.dtype))
        return holder, names[-1], index

    def _set_limits(self, field: MessageField) -> None:
        scale, offset = self._mapping.scale, self._mapping.offset
        limits = sorted((limit - offset) / scale for limit in (RANGE_MIN, RANGE_MAX))
        self._set_beside(field, dict(zip(("range_min", "range_max"), limits, strict=True)))

    def _set_beside(self, field: MessageField, numbers: Mapping[str, float]) -> None:
        for name, number in numbers.items():
            if field.sibling(name, self._types) is not None:
                setattr(self._holder, name, number)

    def _error(self, reason: str) -> MadrobError:
        return MadrobError(
            f"{self._mapping.topic} cannot be simulated ({reason}); simulate the default topics"
        )
