"""Run folders with results as the engine writes them, without an engine."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from madrob_console.archive.folders import RESULT_FILE, RunName
from madrob_console.referee.flags import Flag, FlagKind, FlagWeight
from madrob_console.referee.run_summary import RunSummary
from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition, Outcome, Signal, Thresholds
from scoring.result import libraries_here

EPOCH = 1_700_000_000.0
HOUR = 3600.0
VALUES: Mapping[str, float] = {
    "execution_time": 17.432,
    "time_to_handle": 3.214,
    "door_occupation_time": 4.5,
    "passage_time": 12.25,
    "unsafety_of_door_operation": 1.875,
    "smoothness_of_door_actuation": 0.0625,
    "roughness_of_door_actuation": 14.75,
    "capability_level": 6,
}


_SAID = "waivers", "false_starts", "incidents", "rulings", "notes"
_VOIDED = {"time": EPOCH, "reason": "the floor was wet", "referee": "R"}
_THRESHOLDS: dict[str, Any] = msgspec.to_builtins(Thresholds())
_DOOR: dict[str, Any] = {
    **dict.fromkeys(("samples", "gaps", "dropped", "shifted", "no_reading"), 0),
    **dict.fromkeys(("largest_gap", "jitter", "skew")),
    "signal": Signal.DOOR.value,
}


def document(run: RunSummary) -> dict[str, Any]:
    """What `result.json` says of a run."""
    return {
        "format": 1,
        "software": "madrob-console 0.2.0",
        "competition": run.competition,
        "source": run.source,
        "issue": run.issue,
        "subject": run.subject,
        "team": run.team,
        "run_number": run.run_number,
        "condition_number": run.condition,
        "setup": {
            "subject": run.subject,
            "team": "of the set-up",
            "run_number": run.run_number,
            "condition": msgspec.to_builtins(Condition.from_number(run.condition)),
            "start_pose": {"x": 1.5, "y": 0.0, "yaw": 180.0},
            "referee": "R",
            "timeout": 300.0,
            "countdown": 5.0,
            "ruleset": run.ruleset,
            "lock_detection": "auto",
            "practice": run.practice,
        },
        "handle_zero": 0.0,
        "ruleset": run.ruleset,
        "outcome": run.outcome,
        "outcome_reason": "all six steps done" if run.valid else run.reason,
        "start": run.started,
        "stop": None,
        "lock_detection": "settle",
        **{key: [] for key in ("steps", "events", *_SAID)},
        "remark": "",
        "indicators": {
            name: {
                "value": run.values.get(name),
                "unit": name.spec.unit,
                "reason": None if name in run.values else "why not",
                "uncertainty": msgspec.to_builtins(run.uncertainties.get(name)),
                "doubts": ["why it may be wrong"] * run.doubts.get(name, 0),
            }
            for name in IndicatorName
        },
        "run_id": run.run_id,
        "testbed": run.testbed,
        "quality": {"signals": [_DOOR | {"rate": run.rate}]},
        "thresholds": {**_THRESHOLDS, **(run.thresholds or {})},
        "journal": {"lines": 0, "sha256": "0" * 64},
        "mappings": [],
        "libraries": msgspec.to_builtins(libraries_here()),
        **({"voided": _VOIDED} if run.voided else {}),
        "flags": msgspec.to_builtins(run.flags),
        **({} if run.protest_filed is None else {"protests": [_open_protest(run)]}),
        "closure": {"time": 0.0, "referee": "R", "team_word": run.team_word, "note": ""}
        if run.final
        else None,
    }


def _open_protest(run: RunSummary) -> dict[str, Any]:
    at = None if run.protest_at is None else run.started + run.protest_at
    told = {"number": 1, "team": run.team, "text": "too dark", "about": "run"}
    return {**told, "time": run.protest_filed, "at": at, "referee": "R", "answer": None}


UNDECIDED_START = Flag(
    FlagKind.FALSE_START,
    "1 false start UNDECIDED (handle touched)",
    FlagWeight.ALARM,
    undecided=True,
)
"""A flag that waits for the referee."""


def summary(
    subject: int = 3,
    condition: int = 7,
    run_number: int = 1,
    *,
    hour: float = 0.0,
    **fields: object,
) -> RunSummary:
    """A run, completed and official unless `fields` say otherwise, `hour` hours after `EPOCH`."""
    started = EPOCH + hour * HOUR
    told: dict[str, Any] = {
        "team": f"Team {subject}",
        "outcome": Outcome.COMPLETED,
        "values": dict(VALUES),
        "issue": 1,
        "source": "ros",
        "competition": "Autumn Cup",
        "ruleset": "protocol",
        "thresholds": {},
    }
    told.update(fields)
    told.setdefault("practice", told["source"] == "simulated")
    return RunSummary(
        folder=RunName(subject, condition, run_number).folder_name(started),
        subject=subject,
        condition=condition,
        run_number=run_number,
        started=started,
        **told,
    )


def put_hole(path: Path) -> None:
    """A file of 20 GB with nothing in it."""
    path.touch()
    os.truncate(path, 20 * 10**9)


def write(root: Path, run: RunSummary) -> Path:
    """The run's folder with its result; returns the path of the result."""
    path = root / run.folder / RESULT_FILE
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document(run), indent=2))
    return path
