"""The JSON schemas (draft 2020-12) of what the engine publishes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from madrob_console.archive.result_document import described_schema
from madrob_console.engine.public_state import PublishedState, SpectatorState
from madrob_console.referee.acts import ACTS
from madrob_console.referee.journal import Entry
from madrob_console.referee.rebuild import Change
from madrob_console.referee.records import FaultKind
from scoring.protocol import EventName, Outcome

_TIME = {"type": "number", "description": "when it happened, s since 1970."}
_EVENT = {"enum": list(EventName), "description": "named as in the EUROBENCH event file."}
_OUTCOME = {"enum": list(Outcome), "description": "how the run ended."}
_FAULT = {"enum": list(FaultKind), "description": "kind of the fault."}
_ISSUE = {"type": "integer", "description": "number of the result."}

_DETAILS: Mapping[Change, Mapping[str, object]] = {
    Change.COUNTDOWN_BEGINS: {"time": _TIME},
    Change.COUNTDOWN_HELD: {"time": _TIME},
    Change.RUN_STARTS: {"event": _EVENT, "time": _TIME},
    Change.ROBOT_STARTS: {"time": _TIME},
    Change.ROBOT_SAYS: {"time": _TIME},
    Change.EVENT: {"event": _EVENT, "time": _TIME},
    Change.FALSE_START: {"event": _EVENT, "time": _TIME},
    Change.TIMEOUT_ELAPSED: {"time": _TIME},
    Change.RUN_STOPS: {"outcome": _OUTCOME, "time": _TIME},
    Change.FAULT: {"kind": _FAULT, "time": _TIME},
    Change.RESULT_WRITTEN: {"issue": _ISSUE},
}
"""What robots may rely on in the `details` of a line, by its `what`."""


def state_schema() -> dict[str, Any]:
    """Of `/madrob/referee/state`."""
    return _schema("state", described_schema(PublishedState, PublishedState))


def watch_schema() -> dict[str, Any]:
    """Of a line of `madrob watch --json`."""
    return _schema("watch", described_schema(SpectatorState, SpectatorState, PublishedState))


def event_schema() -> dict[str, Any]:
    """Of `/madrob/referee/event`."""
    root, parts = described_schema(Entry, Entry)
    line = parts[Entry.__name__]
    line["properties"]["what"]["enum"] = [*Change, *(act.name for act in ACTS)]
    line["required"] = [key for key in line["properties"] if key != "id"]
    line["allOf"] = [
        {
            "if": {"properties": {"what": {"const": what}}},
            "then": {"properties": {"details": {"properties": keys, "required": list(keys)}}},
        }
        for what, keys in _DETAILS.items()
    ]
    return _schema("event", (root, parts))


def _schema(name: str, described: tuple[dict[str, Any], dict[str, Any]]) -> dict[str, Any]:
    root, parts = described
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:madrob:{name}:1",
        "title": f"MADROB {name}",
        **root,
        "$defs": parts,
    }
