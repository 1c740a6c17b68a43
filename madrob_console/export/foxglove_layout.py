"""A layout of Foxglove for the topics of a run's recording."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from madrob_console.common.errors import MadrobError
from madrob_console.messages.codec import (
    REFEREE_EVENT_TOPIC,
    REFEREE_START_POSE_TOPIC,
    REFEREE_STATE_TOPIC,
    START_POSE_FRAME,
    TopicMapping,
)
from madrob_console.messages.message_types import find_stamp, standard_types
from scoring.protocol import PASSAGE_SENSORS, Side, Signal, Thresholds

LAYOUT_FILE = "madrob_foxglove_layout.json"

_DOOR, _HANDLE = "Plot!door", "Plot!handle"
_CW, _CCW = "Plot!passage_cw", "Plot!passage_ccw"
_EVENTS, _STATE = "RawMessages!referee_event", "RawMessages!referee_state"
_COURSE, _SCENE = "StateTransitions!course", "3D!doorway"
_RECEIVED, _STAMPED = "receiveTime", "headerStamp"
_SCAN = "sensor_msgs/msg/LaserScan"

_PHASE = "/studio_script/madrob_phase"
_EVENT = "/studio_script/madrob_event"
_SCRIPT = """\
import {{ Input }} from "./types";

type Output = {{ word: string }};

export const inputs = ["{topic}"];
export const output = "{output}";

export default function script(event: Input<"{topic}">): Output {{
  const said = JSON.parse(event.message.data);
  return {{ word: String({word}) }};
}}
"""
"""Foxglove user script: state and events are JSON in a text, which no panel reads."""


@dataclass(frozen=True, slots=True)
class HandleZero:
    """The handle's reading at rest, N, as it was set for `run` (in words)."""

    force: float
    run: str


@dataclass(frozen=True, slots=True)
class _Axis:
    """A published signal; `stamped` if its messages have stamps, as far as the type is known."""

    mapping: TopicMapping
    stamped: bool

    @property
    def as_published(self) -> str:
        own_unit = (self.mapping.scale, self.mapping.offset) != (1.0, 0.0)
        return ", as published" if own_unit else ""

    def line(self, label: str, index: str = "") -> dict[str, Any]:
        value = f"{self.mapping.topic}.{self.mapping.field}{index}"
        return _path(value, f"{label}{self.as_published}", stamped=self.stamped)

    def threshold(self, value: float, label: str) -> dict[str, Any]:
        """A line at `value` (in the protocol's unit), where the published values cross it."""
        published = (value - self.mapping.offset) / self.mapping.scale
        return _path(f"{published:.6g}", label, stamped=False)


def foxglove_layout(
    mappings: Sequence[TopicMapping],
    thresholds: Thresholds | None = None,
    zero: HandleZero | None = None,
) -> dict[str, Any]:
    """A layout to import: the testbed's signals with the thresholds that make events of them.

    Times are the messages' stamps, as in the scores. It also shows phases, events, the
    referee's messages, and the doorway if the recording has its frames. Without `thresholds`
    the protocol's are used; `zero` None = it was never set.
    """
    limits = thresholds or Thresholds()
    axes = {m.signal: _Axis(m, _is_stamped(m.type)) for m in mappings}
    return {
        "configById": {
            _DOOR: _plot("Door", _door(axes, limits)),
            _HANDLE: _plot("Handle", _handle(axes, limits, zero)),
            _CW: _plot("Passage sensors CW", _passage(Side.CW, axes, limits)),
            _CCW: _plot("Passage sensors CCW", _passage(Side.CCW, axes, limits)),
            _COURSE: _transitions(axes),
            _SCENE: _doorway(mappings),
            _EVENTS: _messages("Referee's events", REFEREE_EVENT_TOPIC),
            _STATE: _messages("State of the run", REFEREE_STATE_TOPIC),
        },
        "globalVariables": {},
        "userNodes": {
            "madrob_phase": _script("phase", REFEREE_STATE_TOPIC, _PHASE, "said.phase"),
            "madrob_event": _script(
                "event", REFEREE_EVENT_TOPIC, _EVENT, "said.details.event ?? said.what"
            ),
        },
        "playbackConfig": {"speed": 1},
        "layout": _split(
            "row",
            65,
            _split(
                "column",
                20,
                _COURSE,
                _split(
                    "column",
                    50,
                    _split("column", 50, _DOOR, _HANDLE),
                    _split("column", 50, _CW, _CCW),
                ),
            ),
            _split("column", 50, _SCENE, _split("column", 50, _EVENTS, _STATE)),
        ),
    }


def _is_stamped(type_name: str) -> bool:
    try:
        return find_stamp(standard_types(), type_name) is not None
    except MadrobError:
        return False  # of a type that only the testbed knows; its arrival is known in any case


def _door(axes: dict[Signal, _Axis], limits: Thresholds) -> Iterator[dict[str, Any]]:
    if (door := axes.get(Signal.DOOR)) is not None:
        yield door.line("angle, rad")
        for angle in (limits.closed_angle, -limits.closed_angle):
            yield door.threshold(angle, f"closed within {limits.closed_angle:g} rad")
    if (latch := axes.get(Signal.LATCH)) is not None:
        yield latch.line("latch engaged")


def _handle(
    axes: dict[Signal, _Axis], limits: Thresholds, zero: HandleZero | None
) -> Iterator[dict[str, Any]]:
    if (handle := axes.get(Signal.HANDLE)) is None:
        return
    yield handle.line("force, N")
    rest, whose = (0.0, "0 N") if zero is None else (zero.force, f"{zero.force:.2f} N, {zero.run}")
    for force in (limits.touch_force, -limits.touch_force):
        yield handle.threshold(
            rest + force, f"touch, {limits.touch_force:.2f} N from the zero ({whose})"
        )


def _passage(side: Side, axes: dict[Signal, _Axis], limits: Thresholds) -> Iterator[dict[str, Any]]:
    reach = limits.lintel_height - limits.present_height
    drawn = None
    for sensor in PASSAGE_SENSORS:
        axis = axes.get(Signal.of_strip(sensor.strip))
        if sensor.side is side and axis is not None:
            drawn = axis
            yield axis.line(f"{side} {sensor.index}, distance down", f"[{sensor.element}]")
    if drawn is not None:
        words = f"present: higher than {limits.present_height:g} m"
        yield drawn.threshold(reach, words)


def _transitions(axes: dict[Signal, _Axis]) -> dict[str, Any]:
    latch = axes.get(Signal.LATCH)
    paths = [
        _path(f"{_PHASE}.word", "phase", stamped=False),
        _path(f"{_EVENT}.word", "event", stamped=False),
        *([] if latch is None else [latch.line("latch engaged")]),
    ]
    return {"foxglovePanelTitle": "Course of the run", "isSynced": True, "paths": paths}


def _doorway(mappings: Iterable[TopicMapping]) -> dict[str, Any]:
    """Scans and start pose, if the recording says where the sensors are (`/tf_static`)."""
    topics = [m.topic for m in mappings if m.type == _SCAN]
    return {
        "foxglovePanelTitle": "Doorway",
        "followMode": "follow-pose",
        "followTf": START_POSE_FRAME,
        "cameraState": {
            "perspective": True,
            "distance": 6,
            "phi": 60,
            "thetaOffset": 45,
            "target": [0, 0, 0],
            "targetOffset": [0, 0, 1],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.1,
            "far": 100,
        },
        "layers": {"grid": {"layerId": "foxglove.Grid", "visible": True, "size": 4}},
        "topics": {topic: {"visible": True} for topic in (*topics, REFEREE_START_POSE_TOPIC)},
    }


def _script(name: str, topic: str, output: str, word: str) -> dict[str, str]:
    code = _SCRIPT.format(topic=topic, output=output, word=word)
    return {"name": f"MADROB {name}", "sourceCode": code}


def _path(value: str, label: str, *, stamped: bool) -> dict[str, Any]:
    method = _STAMPED if stamped else _RECEIVED
    return {"value": value, "label": label, "enabled": True, "timestampMethod": method}


def _plot(title: str, paths: Iterable[dict[str, Any]]) -> dict[str, Any]:
    return {
        "foxglovePanelTitle": title,
        "paths": list(paths),
        "xAxisVal": "timestamp",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": True,
        "isSynced": True,
        "sidebarDimension": 240,
    }


def _messages(title: str, topic: str) -> dict[str, Any]:
    return {
        "foxglovePanelTitle": title,
        "topicPath": topic,
        "diffEnabled": False,
        "diffMethod": "custom",
        "diffTopicPath": "",
        "showFullMessageForDiff": False,
    }


def _split(direction: str, percentage: int, first: object, second: object) -> dict[str, object]:
    return {
        "direction": direction,
        "first": first,
        "second": second,
        "splitPercentage": percentage,
    }
