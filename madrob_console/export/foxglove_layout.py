"""A layout of Foxglove for the topics of a run's recording.

`foxglove_layout.json` is the layout. A path in it that names a `signal` shows the testbed's topic,
or one of the `level`s at which the signal makes an event.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from importlib.resources import files
from typing import Any

import msgspec

from madrob_console.archive.result_document import ResultDocument
from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.messages.message_fields import find_stamp
from madrob_console.messages.message_types import standard_types
from scoring.protocol import Thresholds

LAYOUT_FILE = "madrob_foxglove_layout.json"

_LAYOUT = files(__package__) / "foxglove_layout.json"
_SCAN = "sensor_msgs/msg/LaserScan"


def foxglove_layout(
    measured: ResultDocument | None, cameras: Collection[str] = ()
) -> dict[str, Any]:
    """A layout to import: the testbed's signals with the thresholds that make events of them.

    Times are the messages' stamps, as in the scores. It also shows phases, events, the
    referee's messages, the doorway if the recording has its frames, and the pictures of `cameras`,
    which are topics. Topics, thresholds and the handle's zero are those of a result; the protocol's
    where there is none, or where it does not tell.
    """
    mappings, limits, rest, whose = DEFAULT_MAPPINGS, Thresholds(), 0.0, "0 N"
    if measured is not None:
        mappings, limits = measured.mappings or mappings, measured.thresholds or limits
        if (zero := measured.zero_samples) is not None:
            of = f"run {measured.run_number} of condition {measured.condition_number}"
            rest, whose = zero.mean, f"{zero.mean:.2f} N, {of}"
    closed, touch, present = limits.closed_angle, limits.touch_force, limits.present_height
    levels = {
        "closed": closed,
        "-closed": -closed,
        "touch": rest + touch,
        "-touch": rest - touch,
        "present": limits.lintel_height - present,
    }
    words = {"closed": closed, "touch": touch, "present": present, "zero": whose}
    of_signal = {mapping.signal.name: mapping for mapping in mappings}
    layout: dict[str, Any] = msgspec.json.decode(_LAYOUT.read_bytes())
    panels = layout["configById"]
    for panel in panels.values():
        if "paths" in panel:
            panel["paths"] = [
                _of_testbed(path, of_signal[path["signal"]], levels, words)
                if "signal" in path
                else path
                for path in panel["paths"]
                if "signal" not in path or path["signal"] in of_signal
            ]
    scans = [mapping.topic for mapping in mappings if mapping.type == _SCAN]
    doorway = panels["3D!doorway"]
    doorway["topics"] = {topic: {"visible": True} for topic in scans} | doorway["topics"]
    pictures: Any = None
    for number, topic in enumerate(cameras):
        name = f"Image!{number}"
        panels[name] = {"foxglovePanelTitle": topic, "imageMode": {"imageTopic": topic}}
        pictures = {"direction": "row", "first": pictures, "second": name} if number else name
    if pictures is not None:
        layout["layout"] = {
            "direction": "column",
            "first": layout["layout"],
            "second": pictures,
            "splitPercentage": 65,
        }
    return layout


def _of_testbed(
    path: Mapping[str, str],
    mapping: TopicMapping,
    levels: Mapping[str, float],
    words: Mapping[str, object],
) -> dict[str, object]:
    """A path with the topic of its signal, or with a level as the testbed publishes it."""
    label = path["label"].format(**words)
    if "level" in path:
        published = (levels[path["level"]] - mapping.offset) / mapping.scale
        return _path(f"{published:.6g}", label, "receiveTime")
    own_unit = (mapping.scale, mapping.offset) != (1.0, 0.0)
    value = f"{mapping.topic}.{mapping.field}{path.get('field', '')}"
    clock = "headerStamp" if _is_stamped(mapping.type) else "receiveTime"
    return _path(value, f"{label}, as published" if own_unit else label, clock)


def _is_stamped(type_name: str) -> bool:
    try:
        return find_stamp(standard_types(), type_name) is not None
    except MadrobError:
        return False  # of a type that only the testbed knows; its arrival is known in any case


def _path(value: str, label: str, clock: str) -> dict[str, object]:
    return {"value": value, "label": label, "enabled": True, "timestampMethod": clock}
