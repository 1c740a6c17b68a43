"""A layout of Foxglove for the topics of a run's recording."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from madrob_console.messages.codec import REFEREE_EVENT_TOPIC, REFEREE_STATE_TOPIC, TopicMapping
from scoring.protocol import PASSAGE_SENSORS, Side, Signal

LAYOUT_FILE = "madrob_foxglove_layout.json"
"""How the layout is called where it is a file."""

_DOOR, _HANDLE = "Plot!door", "Plot!handle"
_CW, _CCW = "Plot!passage_cw", "Plot!passage_ccw"
_EVENTS, _STATE = "RawMessages!referee_event", "RawMessages!referee_state"


def foxglove_layout(mappings: Sequence[TopicMapping]) -> dict[str, Any]:
    """A layout to be imported: plots of the testbed's signals, the referee's messages beside them.

    Args:
        mappings: which topic carries which signal.
    """
    paths = {m.signal: f"{m.topic}.{m.field}" for m in mappings}
    own_units = {m.signal for m in mappings if (m.scale, m.offset) != (1.0, 0.0)}

    def lines(labels: Iterable[tuple[Signal, str]]) -> list[tuple[str, str]]:
        """The message paths of signals, with their labels; of published numbers as they are."""
        return [
            (paths[signal], f"{label}, as published" if signal in own_units else label)
            for signal, label in labels
            if signal in paths
        ]

    door = lines([(Signal.DOOR, "angle, rad"), (Signal.LATCH, "latch engaged")])
    handle = lines([(Signal.HANDLE, "force, N")])
    return {
        "configById": {
            _DOOR: _plot("Door", door),
            _HANDLE: _plot("Handle", handle),
            _CW: _plot("Passage sensors CW", _passage(Side.CW, paths)),
            _CCW: _plot("Passage sensors CCW", _passage(Side.CCW, paths)),
            _EVENTS: _messages("Referee's events", REFEREE_EVENT_TOPIC),
            _STATE: _messages("State of the run", REFEREE_STATE_TOPIC),
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split(
            "row",
            65,
            _split(
                "column", 50, _split("column", 50, _DOOR, _HANDLE), _split("column", 50, _CW, _CCW)
            ),
            _split("column", 50, _EVENTS, _STATE),
        ),
    }


def _passage(side: Side, paths: dict[Signal, str]) -> list[tuple[str, str]]:
    """The used sensors of a side: their distances to the first thing below."""
    return [
        (f"{path}[{sensor.element}]", f"{side} {sensor.index}, distance down")
        for sensor in PASSAGE_SENSORS
        if sensor.side is side and (path := paths.get(Signal.of_strip(sensor.strip))) is not None
    ]


def _plot(title: str, lines: Sequence[tuple[str, str]]) -> dict[str, Any]:
    return {
        "foxglovePanelTitle": title,
        "paths": [
            {"value": path, "label": label, "enabled": True, "timestampMethod": "receiveTime"}
            for path, label in lines
        ],
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
