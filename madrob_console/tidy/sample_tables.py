"""The tables of a recording's samples: which there are, and what stands in each column."""

from __future__ import annotations

from dataclasses import replace

from madrob_console.tidy.run_tables import COURSE, PRACTICE, TASK, WHOSE
from madrob_console.tidy.tidy_table import CellKind, TidyColumn, TidyTable

_RUN = TidyColumn("run", CellKind.TEXT, "", "name of the run's folder")
_TIMES = (
    TidyColumn("time", CellKind.NUMBER, "s", "stamp, since 1970 (UTC)"),
    TidyColumn("since_start", CellKind.NUMBER, "s", "the same, since the start of the run"),
)


def _series(name: str, row: str, *columns: TidyColumn) -> TidyTable:
    """A table of one sensor's samples."""
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
"""All of a run, in the order in which they are written."""
