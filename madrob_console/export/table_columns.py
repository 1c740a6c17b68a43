"""Tables for programs: their columns, each with its cell, of runs and of samples."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from madrob_console.archive.result_files import StoredRun

Row: TypeAlias = Mapping[str, object]
"""Cells of a row by column."""


class CellKind(Enum):
    """Kind of a column's cells; the value is pandas' type name. Only texts are never empty."""

    TEXT = "str"
    COUNT = "Int64"
    NUMBER = "float64"
    FLAG = "boolean"


@dataclass(frozen=True, slots=True)
class TidyColumn:
    """One column; an empty `unit` is none, `meaning` explains empty cells, too.

    `cell` takes the run and what the row is of: a `StoredRun` and one of the table's items, or a
    `SampledRun`, whose cell is then the whole column.
    """

    name: str
    kind: CellKind
    unit: str
    meaning: str
    cell: Callable[[Any, Any], Any]


@dataclass(frozen=True, slots=True)
class TidyTable:
    """One table: how its file names end, what a row is, its columns from left to right.

    `items` is what its rows are of, in a run.
    """

    name: str
    row: str
    columns: Sequence[TidyColumn]
    items: Callable[[Any], Iterable[object]] = lambda _run: (None,)

    def row_of(self, run: object, item: object = None) -> Row:
        return {column.name: column.cell(run, item) for column in self.columns}


def rows_of(table: TidyTable, run: StoredRun) -> Iterator[Row]:
    return (table.row_of(run, item) for item in table.items(run))


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


def _since_start(run: Any, time: Any) -> Any:  # noqa: ANN401  of both kinds of runs; s, or many
    return None if time is None else time - run.result.start


WHOSE = (
    TidyColumn(
        "subject", CellKind.COUNT, "", "number of the team", lambda run, _: run.label.subject
    ),
    TidyColumn(
        "team", CellKind.TEXT, "", "its name; empty: it has none", lambda run, _: run.label.team
    ),
    TidyColumn(
        "condition",
        CellKind.COUNT,
        "",
        "number of the condition, 1 to 20",
        lambda run, _: run.label.condition,
    ),
    TidyColumn("run", CellKind.COUNT, "", "number of the repetition", lambda run, _: run.label.run),
    TidyColumn(
        "run_id",
        CellKind.TEXT,
        "",
        "which run of all testbeds: the key to join tables",
        lambda run, _: run.label.run_id,
    ),
    TidyColumn(
        "testbed",
        CellKind.TEXT,
        "",
        "name of the testbed; empty: it had none",
        lambda run, _: run.label.testbed,
    ),
    TidyColumn(
        "competition",
        CellKind.TEXT,
        "",
        "its name; empty: none was set",
        lambda run, _: run.label.competition,
    ),
)
"""In every table: whose run it is, and which."""

TASK = (
    TidyColumn(
        "benchmark_type",
        CellKind.TEXT,
        "",
        "how the door is braked",
        lambda run, _: run.condition.benchmark_type,
    ),
    TidyColumn(
        "opening_side",
        CellKind.TEXT,
        "",
        "cw or ccw: to where the door opens",
        lambda run, _: run.condition.opening_side,
    ),
    TidyColumn(
        "starting_side",
        CellKind.TEXT,
        "",
        "cw or ccw: where the robot starts",
        lambda run, _: run.condition.starting_side,
    ),
    TidyColumn(
        "destination_side",
        CellKind.TEXT,
        "",
        "cw or ccw: where it has to go",
        lambda run, _: run.condition.destination_side,
    ),
)
"""Columns of the condition."""

_OUTCOME = TidyColumn(
    "outcome", CellKind.TEXT, "", "how the run ended", lambda run, _: run.result.outcome
)

COURSE = (
    TidyColumn(
        "lock_detection",
        CellKind.TEXT,
        "",
        "what decides step 6",
        lambda run, _: run.result.lock_detection,
    ),
    _OUTCOME,
    TidyColumn(
        "start",
        CellKind.NUMBER,
        "s",
        "of the run, since 1970 (UTC)",
        lambda run, _: run.result.start,
    ),
    TidyColumn(
        "stop",
        CellKind.NUMBER,
        "s",
        "likewise; empty: it was cut off",
        lambda run, _: run.result.stop,
    ),
    TidyColumn(
        "duration",
        CellKind.NUMBER,
        "s",
        "from start to stop; empty: likewise",
        lambda run, _: _since_start(run, run.result.stop),
    ),
)
"""Columns of when it was and how it ended."""

PRACTICE = TidyColumn(
    "practice", CellKind.FLAG, "", "whether it was practice", lambda run, _: run.practice
)
_RULESET = TidyColumn(
    "ruleset", CellKind.TEXT, "", "the rules of its result", lambda run, _: run.result.ruleset
)
_VALID = TidyColumn(
    "valid",
    CellKind.FLAG,
    "",
    "completed or timeout, and not void",
    lambda run, _: run.result.valid,
)

RUNS = TidyTable(
    "runs",
    "one row for each run with a result",
    (
        *WHOSE,
        TidyColumn(
            "folder",
            CellKind.TEXT,
            "",
            "name of its folder; tables of samples call it run",
            lambda run, _: run.folder.name,
        ),
        TidyColumn(
            "place",
            CellKind.TEXT,
            "",
            "path of its folder",
            lambda run, _: run.folder,
        ),
        TidyColumn(
            "source",
            CellKind.TEXT,
            "",
            "ros, simulated or replay",
            lambda run, _: run.source,
        ),
        PRACTICE,
        _RULESET,
        *TASK,
        *COURSE,
        TidyColumn(
            "reason",
            CellKind.TEXT,
            "",
            "why it ended so, in words",
            lambda run, _: run.result.outcome_reason,
        ),
        _VALID,
        TidyColumn(
            "void",
            CellKind.FLAG,
            "",
            "the referee voided it",
            lambda run, _: run.result.voided is not None,
        ),
        TidyColumn("issue", CellKind.COUNT, "", "of its result", lambda run, _: run.result.issue),
        TidyColumn(
            "final",
            CellKind.FLAG,
            "",
            "the result is final",
            lambda run, _: run.result.closure is not None,
        ),
        TidyColumn(
            "team_word",
            CellKind.TEXT,
            "",
            "of the team, to a final result",
            lambda run, _: run.result.closure.team_word if run.result.closure else "",
        ),
        TidyColumn(
            "protests",
            CellKind.COUNT,
            "",
            "against it, open and closed ones",
            lambda run, _: len(run.result.protests),
        ),
        TidyColumn(
            "open_protests",
            CellKind.COUNT,
            "",
            "of them not decided",
            lambda run, _: sum(one.answer is None for one in run.result.protests),
        ),
        TidyColumn(
            "protest_filed",
            CellKind.NUMBER,
            "s",
            "the first open one, since 1970; empty: none",
            lambda run, _: run.result.open_protest.time if run.result.open_protest else None,
        ),
        TidyColumn(
            "flags",
            CellKind.TEXT,
            "",
            "what a decision hangs on; several: with ;",
            lambda run, _: "; ".join(flag.words for flag in run.result.flags or ()),
        ),
        TidyColumn(
            "undecided",
            CellKind.COUNT,
            "",
            "flags that wait for the referee",
            lambda run, _: run.undecided,
        ),
        TidyColumn(
            "sampling_rate",
            CellKind.NUMBER,
            "Hz",
            "of the door; empty: not known",
            lambda run, _: run.result.rate,
        ),
        TidyColumn(
            "software",
            CellKind.TEXT,
            "",
            "what recorded it, with its version",
            lambda run, _: run.result.software,
        ),
        TidyColumn(
            "libraries",
            CellKind.TEXT,
            "",
            "what computed its result, with versions; empty: not known",
            lambda run, _: run.libraries,
        ),
        TidyColumn(
            "thresholds_changed",
            CellKind.TEXT,
            "",
            "numbers of the testbed that are not the protocol's; empty: none, or not known",
            lambda run, _: "; ".join(run.thresholds_changed),
        ),
        TidyColumn(
            "mapping_sha256",
            CellKind.TEXT,
            "",
            "equal: all signals were read alike; 16 digits; empty: not known",
            lambda run, _: run.mapping_digest,
        ),
        TidyColumn(
            "recording_sha256",
            CellKind.TEXT,
            "",
            "checksum of its recording; empty: not known",
            lambda run, _: run.recording_digest,
        ),
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
        TidyColumn("indicator", CellKind.TEXT, "", "its name", lambda _, named: named[0]),
        TidyColumn(
            "value",
            CellKind.NUMBER,
            "",
            "in its unit; empty: there is none",
            lambda _, named: named[1].value,
        ),
        TidyColumn(
            "unit",
            CellKind.TEXT,
            "",
            "of value and uncertainties",
            lambda _, named: named[1].unit,
        ),
        TidyColumn(
            "reason",
            CellKind.TEXT,
            "",
            "why there is no value; empty: there is one",
            lambda _, named: named[1].reason or "",
        ),
        TidyColumn(
            "uncertainty",
            CellKind.NUMBER,
            "",
            "standard; empty: not known",
            lambda _, named: named[1].uncertainty and named[1].uncertainty.u,
        ),
        TidyColumn(
            "expanded_uncertainty",
            CellKind.NUMBER,
            "",
            "of 95 in 100; empty: not known",
            lambda _, named: named[1].uncertainty and named[1].uncertainty.expanded,
        ),
        TidyColumn(
            "at_rest",
            CellKind.NUMBER,
            "",
            "how much of the value the sensor reads at rest",
            lambda _, named: named[1].uncertainty and named[1].uncertainty.rest,
        ),
        TidyColumn(
            "doubts",
            CellKind.TEXT,
            "",
            "sentences, with ; between; empty: none",
            lambda _, named: "; ".join(named[1].doubts),
        ),
    ),
    lambda run: run.result.indicators.items(),
)

EVENTS = TidyTable(
    "events",
    "one row for each event of a run",
    (
        *WHOSE,
        _RULESET,
        TidyColumn(
            "event", CellKind.TEXT, "", "as EUROBENCH names it", lambda _, event: event.event
        ),
        TidyColumn("time", CellKind.NUMBER, "s", "since 1970 (UTC)", lambda _, event: event.time),
        TidyColumn(
            "since_start",
            CellKind.NUMBER,
            "s",
            "the same, since the start of the run",
            lambda _, event: event.since_start,
        ),
    ),
    lambda run: run.result.events,
)

STEPS = TidyTable(
    "steps",
    "one row for each run and step, six of them",
    (
        *WHOSE,
        _RULESET,
        TidyColumn("step", CellKind.COUNT, "", "1 to 6", lambda _, step: step.step),
        TidyColumn("name", CellKind.TEXT, "", "in words", lambda _, step: step.name),
        TidyColumn(
            "done",
            CellKind.FLAG,
            "",
            "whether it counts as done",
            lambda _, step: step.final is not None,
        ),
        TidyColumn(
            "time",
            CellKind.NUMBER,
            "s",
            "that counts, since 1970 (UTC); empty: not done",
            lambda _, step: step.final,
        ),
        TidyColumn(
            "since_start",
            CellKind.NUMBER,
            "s",
            "the same, since the start of the run",
            lambda run, step: _since_start(run, step.final),
        ),
        TidyColumn(
            "sensors",
            CellKind.NUMBER,
            "s",
            "automatic finding, since 1970; empty: none",
            lambda _, step: step.sensors,
        ),
        TidyColumn(
            "referee",
            CellKind.FLAG,
            "",
            "confirmed or denied; empty: no word on it",
            lambda _, step: step.referee and step.referee.confirmed,
        ),
        TidyColumn(
            "reason",
            CellKind.TEXT,
            "",
            "why it is not done; empty: it is",
            lambda _, step: "" if step.final is not None else step.reason or "",
        ),
    ),
    lambda run: run.result.steps,
)

RUN_TABLES = (RUNS, INDICATORS, EVENTS, STEPS)
"""From few rows to many."""

UNREADABLE = TidyTable(
    "unreadable",
    "one row for each run that cannot be read",
    (
        TidyColumn("place", CellKind.TEXT, "", "path of its folder or bag", lambda place, _: place),
        TidyColumn("reason", CellKind.TEXT, "", "why, in words", lambda _, reason: reason),
    ),
)
"""Written beside tables of runs that are scored for them."""


# Tables of a recording's samples: their columns, each cell of which is a whole column.


def _series(name: str, row: str, time: Callable[[Any], Any], *columns: TidyColumn) -> TidyTable:
    run = TidyColumn(
        "run",
        CellKind.TEXT,
        "",
        "name of the run's folder",
        lambda run, _: [run.name] * time(run).size,
    )
    times = (
        TidyColumn(
            "time", CellKind.NUMBER, "s", "stamp, since 1970 (UTC)", lambda run, _: time(run)
        ),
        TidyColumn(
            "since_start",
            CellKind.NUMBER,
            "s",
            "the same, since the start of the run",
            lambda run, _: _since_start(run, time(run)),
        ),
    )
    return TidyTable(name, row, (run, *times, *columns))


RUN = TidyTable(
    "run",
    "one row, what else the indicators hang on",
    (
        TidyColumn("run", CellKind.TEXT, "", "name of the run's folder", lambda run, _: run.name),
        *(replace(one, name="run_number") if one.name == "run" else one for one in WHOSE),
        PRACTICE,
        *TASK,
        replace(_RULESET, meaning="by which rules the tables are made"),
        *COURSE,
        TidyColumn(
            "rows_from",
            CellKind.NUMBER,
            "s",
            "since_start of the first rows that count",
            lambda run, _: _since_start(run, run.series.rows_from),
        ),
        TidyColumn(
            "rows_until",
            CellKind.NUMBER,
            "s",
            "since_start of the last rows that count",
            lambda run, _: _since_start(run, run.series.rows_until),
        ),
        TidyColumn(
            "handle_zero",
            CellKind.NUMBER,
            "N",
            "force of the handle at rest",
            lambda run, _: run.result.handle_zero,
        ),
        TidyColumn(
            "touch_force",
            CellKind.NUMBER,
            "N",
            "a touch is above it",
            lambda run, _: run.thresholds.touch_force,
        ),
        TidyColumn(
            "closed_angle",
            CellKind.NUMBER,
            "rad",
            "a closed door is below it",
            lambda run, _: run.thresholds.closed_angle,
        ),
        TidyColumn(
            "lintel_height",
            CellKind.NUMBER,
            "m",
            "of the passage sensors",
            lambda run, _: run.thresholds.lintel_height,
        ),
        TidyColumn(
            "present_height",
            CellKind.NUMBER,
            "m",
            "a robot is higher",
            lambda run, _: run.present_height,
        ),
        TidyColumn(
            "settle_time",
            CellKind.NUMBER,
            "s",
            "closed so long: step 6",
            lambda run, _: run.thresholds.settle_time,
        ),
        TidyColumn(
            "largest_gap",
            CellKind.NUMBER,
            "s",
            "longer intervals are gaps",
            lambda run, _: run.thresholds.largest_gap,
        ),
    ),
)

DOOR = _series(
    "door",
    "one row for each angle of the panel",
    lambda run: run.series.rows.joint_state.time,
    TidyColumn(
        "position",
        CellKind.NUMBER,
        "rad",
        "angle; 0 = closed, positive = ccw",
        lambda run, _: run.series.rows.joint_state.position,
    ),
    TidyColumn(
        "velocity",
        CellKind.NUMBER,
        "rad/s",
        "empty beside gaps and at the ends",
        lambda run, _: run.series.rows.joint_state.velocity,
    ),
    TidyColumn(
        "acceleration",
        CellKind.NUMBER,
        "rad/s^2",
        "likewise",
        lambda run, _: run.series.rows.joint_state.acceleration,
    ),
    TidyColumn(
        "low_passed_acceleration",
        CellKind.NUMBER,
        "rad/s^2",
        "as unsafety has it; likewise",
        lambda run, _: run.series.rows.low_passed,
    ),
    TidyColumn(
        "jerk",
        CellKind.NUMBER,
        "rad/s^3",
        "as smoothness has it; empty: it does not count",
        lambda run, _: run.door_jerk,
    ),
)

HANDLE = _series(
    "handle",
    "one row for each force on the handle",
    lambda run: run.series.rows.force_time,
    TidyColumn(
        "force",
        CellKind.NUMBER,
        "N",
        "as recorded; positive = towards ccw",
        lambda run, _: run.series.rows.force,
    ),
)

PASSAGE = _series(
    "passage",
    "one row for each used passage sensor and message of its strip",
    lambda run: run.series.passage.time,
    TidyColumn(
        "side",
        CellKind.TEXT,
        "",
        "cw or ccw: over which side it hangs",
        lambda run, _: [sensor.side for sensor in run.passage_sensors],
    ),
    TidyColumn(
        "index",
        CellKind.COUNT,
        "",
        "0 (farthest from the hinge) to 4",
        lambda run, _: [sensor.index for sensor in run.passage_sensors],
    ),
    TidyColumn(
        "strip",
        CellKind.TEXT,
        "",
        "which strip holds it",
        lambda run, _: [sensor.strip for sensor in run.passage_sensors],
    ),
    TidyColumn(
        "element",
        CellKind.COUNT,
        "",
        "its place in the strip, 0 to 3",
        lambda run, _: [sensor.element for sensor in run.passage_sensors],
    ),
    TidyColumn(
        "range",
        CellKind.NUMBER,
        "m",
        "down; inf = nothing there, empty = no reading",
        lambda run, _: run.series.passage.distance,
    ),
    TidyColumn(
        "height",
        CellKind.NUMBER,
        "m",
        "of the obstacle; -inf = nothing there",
        lambda run, _: run.thresholds.lintel_height - run.series.passage.distance,
    ),
    TidyColumn(
        "present",
        CellKind.FLAG,
        "",
        "something is there, as it counts; empty = not known yet",
        lambda run, _: [None if one < 0 else one for one in run.series.passage.present.tolist()],
    ),
    TidyColumn(
        "masked",
        CellKind.FLAG,
        "",
        "the panel passes under it",
        lambda run, _: run.series.passage.masked,
    ),
)

LATCH = _series(
    "latch",
    "one row for each message of the latch sensor; none without one",
    lambda run: run.series.latch_time,
    TidyColumn(
        "engaged",
        CellKind.FLAG,
        "",
        "whether the latch is engaged",
        lambda run, _: run.series.latch_engaged,
    ),
)

SAMPLE_TABLES = (RUN, DOOR, HANDLE, PASSAGE, LATCH)
"""In the order in which they are written."""
