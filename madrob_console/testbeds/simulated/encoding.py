"""Readings as messages: the way back through a configured mapping.

Whatever types and units a testbed is configured with, its simulation publishes the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import reduce
from types import MappingProxyType

import numpy as np

from madrob_console.clock import NS
from madrob_console.errors import MadrobError
from madrob_console.messages.codec import TopicMapping
from madrob_console.messages.field_paths import MessageField, attribute, find_field, find_stamp
from madrob_console.messages.message_types import Message, MessageTypes
from madrob_console.testbeds.simulated.sensor_model import RANGE_MAX, RANGE_MIN, Reading
from scoring.protocol import SENSORS_PER_STRIP, Signal, Strip

_STRIPS = {Signal.of_strip(strip) for strip in Strip}


class Encoder:
    """Makes the messages of one topic, by filling one message object again and again.

    Args:
        mapping: the topic, its type and field, scale and offset.
        types: the types known.
        frame: in the header, where there is one.
        scan: fields of a scan, with their values; those beside the ranges are set.

    Raises:
        MadrobError: the type is unknown, or its field cannot hold the signal.
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
        field = find_field(types, mapping.type, mapping.field)
        self._message = types.make(mapping.type)
        stamp = find_stamp(types, mapping.type)
        self._stamp = None if stamp is None else stamp(self._message)
        if stamp is not None:
            self._message.header.frame_id = frame
        self._holder, self._name, self._index = self._place(field)
        self._numbers = field.numbers
        self._base = field.base
        self._check()
        if mapping.signal in _STRIPS:
            self._set_limits(field)
            self._set_beside(field, scan)
        if mapping.type == "sensor_msgs/msg/JointState":
            self._message.name = ["door"]

    def encode(self, stamp_ns: int, reading: Reading) -> bytes:
        """The CDR bytes of a reading taken at `stamp_ns` (ns since the epoch)."""
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
        """A value in the topic's unit and number type."""
        raw = (value - self._mapping.offset) / self._mapping.scale
        if self._base.startswith("float"):
            return raw
        return raw >= 0.5 if self._base == "bool" else round(raw)

    def _place(self, field: MessageField) -> tuple[Message, str, int | None]:
        """The object that holds the field, the field's name in it, and its index."""
        *way, last = field.steps
        index = None
        if isinstance(last, int):
            index = last
            *way, last = way
        names = [attribute(step) for step in (*way, last) if isinstance(step, str)]
        if len(names) <= len(way):
            raise self._error(f"{self._mapping.field} leads through an array of messages")
        holder = reduce(getattr, names[:-1], self._message)
        if index is not None:
            array = getattr(holder, names[-1])
            if len(array) <= index:
                setattr(holder, names[-1], np.zeros(index + 1, array.dtype))
        return holder, names[-1], index

    def _check(self) -> None:
        if self._numbers != (self._mapping.signal in _STRIPS):
            raise self._error(f"{self._mapping.field} does not fit the signal")
        if self._numbers:
            size = len(getattr(self._holder, self._name))
            if size not in (0, SENSORS_PER_STRIP):
                raise self._error(f"{self._mapping.field} holds {size} ranges, not 4")

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
