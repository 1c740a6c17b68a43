"""The whole of `result.json`: its types, and the JSON schema that is published with it.

The names here, in `result_parts` and in `result_referee` are the file's. A key may be added to a
format; one that is dropped, renamed or means something else makes a new one (`RESULT_FORMAT`).
What a class says of its attributes stands in the schema.
"""

from __future__ import annotations

from inspect import cleandoc
from typing import Any, Literal

import msgspec

from madrob_console.archive.folders import RESULT_FORMAT
from madrob_console.archive.result_parts import (
    DataQuality,
    Event,
    FileDigest,
    Indicators,
    StepTimes,
)
from madrob_console.archive.result_referee import (
    Closure,
    FalseStart,
    Incident,
    Note,
    Part,
    Ruling,
    Setup,
    Waiver,
)
from madrob_console.kinds import SourceKind
from scoring.protocol import LockDetection, Outcome
from scoring.rulesets import RulesetName

SCHEMA_FILE = f"madrob_result_schema_{RESULT_FORMAT}.json"
"""How the schema is called where it is a file."""


class ResultDocument(Part, frozen=True):
    """The result of one run of the MADROB benchmark.

    Attributes:
        format: version of this layout.
        software: what wrote it, with its version.
        competition: its name.
        source: where the messages came from; only runs of `ros` are official.
        issue: number of the result's issue; a final result that is opened again gets the next.
        subject: the robot's number, 1 to 999.
        team: the team's name.
        run_number: the repetition, 1 to 999.
        condition_number: 1 to 20, as EUROBENCH counts.
        setup: what was set for the run.
        handle_zero: force of the handle at rest, N; subtracted before a touch is looked for.
        ruleset: the rules that made the indicators.
        outcome: how the run ended; an aborted run is invalid, an interrupted one does not count.
        outcome_reason: why it ended, in words.
        start: s since the epoch.
        stop: s since the epoch; null for a run that was cut off by a failure of the machine.
        indicators: the eight, each with unit and value or reason.
        lock_detection: what decided step 6.
        steps: the six, in order.
        events: by time.
        quality: of the data.
        waivers, false_starts, incidents, rulings, notes: what happened and what the referee said,
            each in the order in which it came.
        closure: how the result was finalised; null = it is provisional.
        remark: on the times.
        files: name -> digest and size, of the recording and the data files.
        files_left_out: which of them have no digest and why, in words.
    """

    format: Literal[1]
    software: str
    competition: str
    source: SourceKind
    issue: int
    subject: int
    team: str
    run_number: int
    condition_number: int
    setup: Setup
    handle_zero: float
    ruleset: RulesetName
    outcome: Outcome
    outcome_reason: str
    start: float
    stop: float | None
    indicators: Indicators
    lock_detection: LockDetection
    steps: tuple[StepTimes, ...]
    events: tuple[Event, ...]
    quality: DataQuality
    waivers: tuple[Waiver, ...]
    false_starts: tuple[FalseStart, ...]
    incidents: tuple[Incident, ...]
    rulings: tuple[Ruling, ...]
    notes: tuple[Note, ...]
    closure: Closure | None
    remark: str
    files: dict[str, FileDigest] = msgspec.field(default_factory=dict)
    files_left_out: tuple[str, ...] = ()


def result_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of `result.json`; its `$id` ends with the format's number."""
    (root,), parts = msgspec.json.schema_components([ResultDocument], ref_template="#/$defs/{name}")
    for part in parts.values():
        _describe(part)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:madrob:result:{RESULT_FORMAT}",
        "title": f"MADROB result, format {RESULT_FORMAT}",
        **root,
        "$defs": parts,
    }


def schema_text() -> bytes:
    """The schema as a file."""
    return msgspec.json.format(msgspec.json.encode(result_schema()), indent=2) + b"\n"


def _describe(part: dict[str, Any]) -> None:
    """What the docstring says of the attributes goes to the properties."""
    about, _, attributes = cleandoc(part.get("description", "")).partition("\n\nAttributes:\n")
    if about:
        part["description"] = about
    names: list[str] = []
    for line in attributes.splitlines():
        if line.startswith(" " * 8):
            more = line.strip()
            for name in names:
                part["properties"][name]["description"] += f" {more}"
            continue
        told, _, text = line.strip().partition(": ")
        names = told.split(", ")
        for name in names:
            part["properties"][name]["description"] = text
