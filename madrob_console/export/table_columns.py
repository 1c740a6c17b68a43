"""Tables for programs: their columns, of runs and of samples."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum, StrEnum


class TableFormat(StrEnum):
    """File format of tables."""

    CSV = "csv"
    NDJSON = "ndjson"
    PARQUET = "parquet"


class CellKind(Enum):
    """Kind of a column's cells; the value is pandas' type name. Only texts are never empty."""

    TEXT = "str"
    COUNT = "Int64"
    NUMBER = "float64"
    FLAG = "boolean"


@dataclass(frozen=True, slots=True)
class TidyColumn:
    """One column; an empty `unit` is none, `meaning` explains empty cells, too."""

    name: str
    kind: CellKind
    unit: str
    meaning: str


@dataclass(frozen=True, slots=True)
class TidyTable:
    """One table: how its file names end, what a row is, its columns from left to right."""

    name: str
    row: str
    columns: Sequence[TidyColumn]


def column_lines(tables: Sequence[TidyTable]) -> Iterator[str]:
    """Help text of the tables: a line for each column, below its table."""
    every = [column for table in tables for column in table.columns]
    names = max(len(column.name) for column in every)
    units = max(len(column.unit) for column in every)
    for table in tables:
        yield f"  {table.name}: {table.row}"
        for one in table.columns:
            yield f"    {one.name:<{names}}  {one.unit:<{units}}  {one.meaning}"


# Tables of runs: their columns.


WHOSE = (
    TidyColumn("subject", CellKind.COUNT, "", "number of the team"),
    TidyColumn("team", CellKind.TEXT, "", "its name; empty: it has none"),
    TidyColumn("condition", CellKind.COUNT, "", "number of the condition, 1 to 20"),
    TidyColumn("run", CellKind.COUNT, "", "number of the repetition"),
    TidyColumn("run_id", CellKind.TEXT, "", "which run of all testbeds: the key to join tables"),
    TidyColumn("testbed", CellKind.TEXT, "", "name of the testbed; empty: it had none"),
    TidyColumn("competition", CellKind.TEXT, "", "its name; empty: none was set"),
)
"""In every table: whose run it is, and which."""

TASK = (
    TidyColumn("benchmark_type", CellKind.TEXT, "", "how the door is braked"),
    TidyColumn("opening_side", CellKind.TEXT, "", "cw or ccw: to where the door opens"),
    TidyColumn("starting_side", CellKind.TEXT, "", "cw or ccw: where the robot starts"),
    TidyColumn("destination_side", CellKind.TEXT, "", "cw or ccw: where it has to go"),
)
"""Columns of the condition."""

_OUTCOME = TidyColumn("outcome", CellKind.TEXT, "", "how the run ended")

COURSE = (
    TidyColumn("lock_detection", CellKind.TEXT, "", "what decides step 6"),
    _OUTCOME,
    TidyColumn("start", CellKind.NUMBER, "s", "of the run, since 1970 (UTC)"),
    TidyColumn("stop", CellKind.NUMBER, "s", "likewise; empty: it was cut off"),
    TidyColumn("duration", CellKind.NUMBER, "s", "from start to stop; empty: likewise"),
)
"""Columns of when it was and how it ended."""

PRACTICE = TidyColumn("practice", CellKind.FLAG, "", "whether it was practice")
_RULESET = TidyColumn("ruleset", CellKind.TEXT, "", "the rules of its result")
_VALID = TidyColumn("valid", CellKind.FLAG, "", "completed or timeout, and not void")
_SINCE_START = TidyColumn(
    "since_start", CellKind.NUMBER, "s", "the same, since the start of the run"
)

RUNS = TidyTable(
    "runs",
    "one row for each run with a result",
    (
        *WHOSE,
        TidyColumn(
            "folder", CellKind.TEXT, "", "name of its folder; tables of samples call it run"
        ),
        TidyColumn("place", CellKind.TEXT, "", "path of its folder"),
        TidyColumn("source", CellKind.TEXT, "", "ros, simulated or replay"),
        PRACTICE,
        _RULESET,
        *TASK,
        *COURSE,
        TidyColumn("reason", CellKind.TEXT, "", "why it ended so, in words"),
        _VALID,
        TidyColumn("void", CellKind.FLAG, "", "the referee voided it"),
        TidyColumn("issue", CellKind.COUNT, "", "of its result"),
        TidyColumn("final", CellKind.FLAG, "", "the result is final"),
        TidyColumn("team_word", CellKind.TEXT, "", "of the team, to a final result"),
        TidyColumn("protests", CellKind.COUNT, "", "against it, open and closed ones"),
        TidyColumn("open_protests", CellKind.COUNT, "", "of them not decided"),
        TidyColumn(
            "protest_due", CellKind.NUMBER, "s", "the next decision, since 1970; empty: none"
        ),
        TidyColumn("flags", CellKind.TEXT, "", "what a decision hangs on; several: with ;"),
        TidyColumn("undecided", CellKind.COUNT, "", "flags that wait for the referee"),
        TidyColumn("sampling_rate", CellKind.NUMBER, "Hz", "of the door; empty: not known"),
        TidyColumn("software", CellKind.TEXT, "", "what recorded it, with its version"),
    ),
)

INDICATORS = TidyTable(
    "indicators",
    "one row for each run and indicator",
    (
        *WHOSE,
        PRACTICE,
        _RULESET,
        _OUTCOME,
        _VALID,
        TidyColumn("indicator", CellKind.TEXT, "", "its name"),
        TidyColumn("value", CellKind.NUMBER, "", "in its unit; empty: there is none"),
        TidyColumn("unit", CellKind.TEXT, "", "of value and uncertainties"),
        TidyColumn("reason", CellKind.TEXT, "", "why there is no value; empty: there is one"),
        TidyColumn("uncertainty", CellKind.NUMBER, "", "standard; empty: not known"),
        TidyColumn("expanded_uncertainty", CellKind.NUMBER, "", "of 95 in 100; empty: not known"),
        TidyColumn("doubts", CellKind.TEXT, "", "sentences, with ; between; empty: none"),
    ),
)

EVENTS = TidyTable(
    "events",
    "one row for each event of a run",
    (
        *WHOSE,
        _RULESET,
        TidyColumn("event", CellKind.TEXT, "", "as EUROBENCH names it"),
        TidyColumn("time", CellKind.NUMBER, "s", "since 1970 (UTC)"),
        _SINCE_START,
    ),
)

STEPS = TidyTable(
    "steps",
    "one row for each run and step, six of them",
    (
        *WHOSE,
        _RULESET,
        TidyColumn("step", CellKind.COUNT, "", "1 to 6"),
        TidyColumn("name", CellKind.TEXT, "", "in words"),
        TidyColumn("done", CellKind.FLAG, "", "whether it counts as done"),
        TidyColumn("time", CellKind.NUMBER, "s", "that counts, since 1970 (UTC); empty: not done"),
        _SINCE_START,
        TidyColumn("sensors", CellKind.NUMBER, "s", "automatic finding, since 1970; empty: none"),
        TidyColumn("referee", CellKind.FLAG, "", "confirmed or denied; empty: no word on it"),
        TidyColumn("reason", CellKind.TEXT, "", "why it is not done; empty: it is"),
    ),
)

RUN_TABLES = (RUNS, INDICATORS, EVENTS, STEPS)
"""From few rows to many."""

UNREADABLE = TidyTable(
    "unreadable",
    "one row for each run that cannot be read",
    (
        TidyColumn("place", CellKind.TEXT, "", "path of its folder or bag"),
        TidyColumn("reason", CellKind.TEXT, "", "why, in words"),
    ),
)
"""Written beside tables of runs that are scored for them."""


# Tables of a recording's samples: their columns.


_RUN = TidyColumn("run", CellKind.TEXT, "", "name of the run's folder")
_TIMES = (
    TidyColumn("time", CellKind.NUMBER, "s", "stamp, since 1970 (UTC)"),
    TidyColumn("since_start", CellKind.NUMBER, "s", "the same, since the start of the run"),
)


def _series(name: str, row: str, *columns: TidyColumn) -> TidyTable:
    return TidyTable(name, row, (_RUN, *_TIMES, *columns))


RUN = TidyTable(
    "run",
    "one row, what else the indicators hang on",
    (
        _RUN,
        *(replace(one, name="run_number") if one.name == "run" else one for one in WHOSE),
        PRACTICE,
        *TASK,
        TidyColumn("ruleset", CellKind.TEXT, "", "by which rules the tables are made"),
        *COURSE,
        TidyColumn("rows_from", CellKind.NUMBER, "s", "since_start of the first rows that count"),
        TidyColumn("rows_until", CellKind.NUMBER, "s", "since_start of the last rows that count"),
        TidyColumn("handle_zero", CellKind.NUMBER, "N", "force of the handle at rest"),
        TidyColumn("touch_force", CellKind.NUMBER, "N", "a touch is above it"),
        TidyColumn("closed_angle", CellKind.NUMBER, "rad", "a closed door is below it"),
        TidyColumn("lintel_height", CellKind.NUMBER, "m", "of the passage sensors"),
        TidyColumn("present_height", CellKind.NUMBER, "m", "a robot is higher"),
        TidyColumn("settle_time", CellKind.NUMBER, "s", "closed so long: step 6"),
        TidyColumn("largest_gap", CellKind.NUMBER, "s", "longer intervals are gaps"),
    ),
)

DOOR = _series(
    "door",
    "one row for each angle of the panel",
    TidyColumn("position", CellKind.NUMBER, "rad", "angle; 0 = closed, positive = ccw"),
    TidyColumn("velocity", CellKind.NUMBER, "rad/s", "empty beside gaps and at the ends"),
    TidyColumn("acceleration", CellKind.NUMBER, "rad/s^2", "likewise"),
    TidyColumn(
        "low_passed_acceleration", CellKind.NUMBER, "rad/s^2", "as unsafety has it; likewise"
    ),
    TidyColumn(
        "jerk", CellKind.NUMBER, "rad/s^3", "as smoothness has it; empty: it does not count"
    ),
)

HANDLE = _series(
    "handle",
    "one row for each force on the handle",
    TidyColumn("force", CellKind.NUMBER, "N", "as recorded; positive = towards ccw"),
)

PASSAGE = _series(
    "passage",
    "one row for each used passage sensor and message of its strip",
    TidyColumn("side", CellKind.TEXT, "", "cw or ccw: over which side it hangs"),
    TidyColumn("index", CellKind.COUNT, "", "0 (farthest from the hinge) to 4"),
    TidyColumn("strip", CellKind.TEXT, "", "which strip holds it"),
    TidyColumn("element", CellKind.COUNT, "", "its place in the strip, 0 to 3"),
    TidyColumn("range", CellKind.NUMBER, "m", "down; inf = nothing there, empty = no reading"),
    TidyColumn("height", CellKind.NUMBER, "m", "of the obstacle; -inf = nothing there"),
    TidyColumn(
        "present", CellKind.FLAG, "", "something is there, as it counts; empty = not known yet"
    ),
    TidyColumn("masked", CellKind.FLAG, "", "the panel passes under it"),
)

LATCH = _series(
    "latch",
    "one row for each message of the latch sensor; none without one",
    TidyColumn("engaged", CellKind.FLAG, "", "whether the latch is engaged"),
)

SAMPLE_TABLES = (RUN, DOOR, HANDLE, PASSAGE, LATCH)
"""In the order in which they are written."""
