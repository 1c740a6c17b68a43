"""Where a testbed publishes which signal.

Lists of results read it, so it needs neither numpy nor rosbags.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

from madrob_console.common.errors import MadrobError
from scoring.protocol import Signal, Strip

STRIPS = {Signal.of_strip(strip): strip for strip in Strip}

LARGEST_READ = 65_536
"""Bytes of the largest message that is read, where its topic has no limit of its own.

Reading takes time: 500,000 names, 4 MB, take 0.2 s. What decides about a run may not wait for that.
A scan of 4096 ranges with intensities has 33 kB.
"""


@dataclass(frozen=True, slots=True)
class TopicMapping:
    """Where the testbed publishes one signal (protocol section 3).

    Attributes:
        signal: which one.
        topic: the topic that carries it. Four mappings of a strip, in the order of its array,
            carry one range each.
        type: of its messages.
        field: the value's path in a message, with dots and optional [index] or [name=door]. A
            strip's field is an array, or a field of each message in an array.
        scale, offset: a sample's value is `field * scale + offset`, in rad, N or m. For strips
            this applies to each range and to the limits; a latch, like any switch, is on from 0.5
            upwards.
        no_echo: what a range says where nothing is under the sensor: `inf`, as REP-117 has it,
            `nan` or a number, before scale and offset.
        largest: a larger message, in bytes, is recorded but not read; null = any is read.
    """

    signal: Signal
    topic: str
    type: str
    field: str
    scale: float = 1.0
    offset: float = 0.0
    no_echo: str = "inf"
    largest: int | None = None

    def __post_init__(self) -> None:
        parse_path(self.field)
        if self.scale == 0 or not math.isfinite(self.scale):
            raise MadrobError(f"{self.topic}: scale {self.scale} loses the signal; use another")
        if not math.isfinite(self.offset):
            raise MadrobError(f"{self.topic}: offset {self.offset} is no number; use another")
        try:
            float(self.no_echo)
        except ValueError:
            words = f"no_echo {self.no_echo!r} is no number: write inf, nan or a range"
            raise MadrobError(f"{self.topic}: {words}") from None

    @property
    def element_name(self) -> str | None:
        """The name of an element without which a message is no sample.

        None = there is none.
        """
        return self.field.partition("=")[2].partition("]")[0] or None

    def limited(self) -> TopicMapping:
        return replace(self, largest=self.largest or LARGEST_READ)


class NamedElement(NamedTuple):
    """The element of an array that is called `value` in the array `names` beside it."""

    names: str
    value: str


Steps: TypeAlias = tuple[str | int | NamedElement, ...]

_STEP = r"([A-Za-z]\w*)(?:\[(?:(\d+)|([A-Za-z]\w*)=([^\[\]]+))\])?"
_PATH = re.compile(rf"{_STEP}(\.{_STEP})*", re.ASCII)
_STEPS = re.compile(_STEP, re.ASCII)


def parse_path(path: str) -> Steps:
    """Split the path of a field.

    MadrobError where it is none.
    """
    if not _PATH.fullmatch(path):
        raise MadrobError(
            f"{path!r} is no field: write names with dots, for example position[0] or "
            "position[name=door]"
        )
    steps: list[str | int | NamedElement] = []
    for name, index, names, value in _STEPS.findall(path):
        steps.append(name)
        if len(index) > 4:
            raise MadrobError(f"{path!r}: no message has so many elements: use a smaller index")
        if index:
            steps.append(int(index))
        elif names:
            steps.append(NamedElement(names, value))
    return tuple(steps)


DEFAULT_MAPPINGS: tuple[TopicMapping, ...] = (
    TopicMapping(
        Signal.DOOR, "/madrob/door/angle", "sensor_msgs/msg/JointState", field="position[0]"
    ),
    TopicMapping(
        Signal.HANDLE,
        "/madrob/handle/force",
        "geometry_msgs/msg/WrenchStamped",
        field="wrench.force.x",
    ),
    *(
        TopicMapping(signal, f"/madrob/passage/{strip}", "sensor_msgs/msg/LaserScan", "ranges")
        for signal, strip in STRIPS.items()
    ),
    TopicMapping(Signal.LATCH, "/madrob/door/locked", "std_msgs/msg/Bool", field="data"),
)
"""The topics of protocol section 3."""
