"""Tables for programs: their columns, each with its cell, of runs and of samples."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

if TYPE_CHECKING:
    from madrob_console.archive.stored_runs import StoredRun
    from scoring.result import Indicator

Row: TypeAlias = Mapping[str, object]
"""Cells of a row by column."""


class CellKind(Enum):
    """Kind of a column's cells; the value is pandas' type name. Only texts are never empty."""

    TEXT = "str"
    COUNT = "Int64"
    NUMBER = "float64"
    FLAG = "boolean"


class RowSource(NamedTuple):
    """What a row is of: a `StoredRun` and one of the table's items, or a `SampledRun`."""

    run: Any
    item: Any = None

    def since_start(self, time: Any) -> Any:  # noqa: ANN401  s since the epoch, or many, or None
        return None if time is None else time - self.run.result.start


@dataclass(frozen=True, slots=True)
class TableColumn:
    """One column; an empty `unit` is none, `meaning` explains empty cells, too.

    `cell` is called with the source of a row; for a `SampledRun` it gives the whole column.
    """

    kind: CellKind
    name: str
    meaning: str
    cell: Callable[[RowSource], Any]
    unit: str = ""


@dataclass(frozen=True, slots=True)
class TidyTable:
    """One table: how its file names end, what a row is, its columns from left to right.

    `items` is what its rows are of, in a run.
    """

    name: str
    row: str
    columns: Sequence[TableColumn]
    items: Callable[[Any], Iterable[object]] = lambda _run: (None,)

    def row_of(self, run: object, item: object = None) -> Row:
        row = RowSource(run, item)
        return {column.name: column.cell(row) for column in self.columns}


def rows_of(table: TidyTable, run: StoredRun) -> Iterator[Row]:
    return (table.row_of(run, item) for item in table.items(run))


def column_lines(tables: Sequence[TidyTable]) -> Iterator[str]:
    """Help text of the tables: a line for each column, below its table."""
    every = [column for table in tables for column in table.columns]
    names = max(len(column.name) for column in every)
    units = max(len(column.unit) for column in every)
    for table in tables:
        yield f"  {table.name}: {table.row}"
        for column in table.columns:
            yield f"    {column.name:<{names}}  {column.unit:<{units}}  {column.meaning}"


def _column(
    kind: CellKind, name: str, meaning: str, cell: str | Callable[[RowSource], Any], unit: str = ""
) -> TableColumn:
    """A column whose cell is a path of attributes, which ends at a None, or a function."""
    return TableColumn(kind, name, meaning, _at(cell) if isinstance(cell, str) else cell, unit)


def _at(path: str) -> Callable[[RowSource], Any]:
    names = path.split(".")

    def cell(row: RowSource) -> Any:  # noqa: ANN401  by its kind
        value: Any = row
        for name in names:
            value = None if value is None else getattr(value, name)
        return value

    return cell


_text, _count, _number, _flag = (partial(_column, kind) for kind in CellKind)


def _since_start(
    time: str,
    name: str = "since_start",
    meaning: str = "the same, since the start of the run",
) -> TableColumn:
    """The column of a path to times, s."""
    at = _at(time)
    return _number(name, meaning, lambda row: row.since_start(at(row)), "s")


class _OfIndicator(NamedTuple):
    name: str
    indicator: Indicator


WHOSE = (
    _count("subject", "number of the team", "run.label.subject"),
    _text("team", "its name; empty: it has none", "run.label.team"),
    _count("condition", "number of the condition, 1 to 20", "run.label.condition"),
    _count("run", "number of the repetition", "run.label.run"),
    _text("run_id", "which run of all testbeds: the key to join tables", "run.label.run_id"),
    _text("testbed", "name of the testbed; empty: it had none", "run.label.testbed"),
    _text("competition", "its name; empty: none was set", "run.label.competition"),
)
"""Columns of every table: the team and the run."""

_TASK = (
    _text("benchmark_type", "how the door is braked", "run.condition.benchmark_type"),
    _text("opening_side", "cw or ccw: to where the door opens", "run.condition.opening_side"),
    _text("starting_side", "cw or ccw: where the robot starts", "run.condition.starting_side"),
    _text("destination_side", "cw or ccw: where it has to go", "run.condition.destination_side"),
)
_OUTCOME = _text("outcome", "how the run ended", "run.result.outcome")
_ENDING = (
    _text("lock_detection", "what decides step 6", "run.result.lock_detection"),
    _OUTCOME,
    _number("start", "of the run, since 1970 (UTC)", "run.result.start", "s"),
    _number("stop", "likewise; empty: it was cut off", "run.result.stop", "s"),
    _since_start("run.result.stop", "duration", "from start to stop; empty: likewise"),
)
_KIND = (
    _flag("practice", "whether it was practice", "run.practice"),
    _flag("rehearsal", "whether it was of a rehearsal", "run.label.rehearsal"),
)
_RULESET = _text("ruleset", "the rules of its result", "run.result.ruleset")
_VALID = _flag("valid", "completed or timeout, and not void", "run.result.valid")

RUNS = TidyTable(
    "runs",
    "one row for each run with a result",
    (
        *WHOSE,
        _text("folder", "name of its folder; tables of samples call it run", "run.folder.name"),
        _text("place", "path of its folder", "run.folder"),
        _text("source", "ros, simulated or replay", "run.result.source"),
        *_KIND,
        _RULESET,
        *_TASK,
        *_ENDING,
        _text("reason", "why it ended so, in words", "run.result.outcome_reason"),
        _VALID,
        _flag("void", "the referee voided it", lambda row: row.run.result.voided is not None),
        _count("issue", "of its result", "run.result.issue"),
        _flag("final", "the result is final", lambda row: row.run.result.closure is not None),
        _text("team_word", "of the team, to a final result", "run.result.closure.team_word"),
        _count(
            "protests",
            "against it, open and closed ones",
            lambda row: len(row.run.result.protests),
        ),
        _count(
            "open_protests",
            "of them not decided",
            lambda row: sum(protest.answer is None for protest in row.run.result.protests),
        ),
        _number(
            "protest_filed",
            "the first open one, since 1970; empty: none",
            "run.result.open_protest.time",
            "s",
        ),
        _text(
            "flags",
            "what a decision hangs on; several: with ;",
            lambda row: "; ".join(flag.words for flag in row.run.result.flags or ()),
        ),
        _count("undecided", "flags that wait for the referee", "run.undecided"),
        _number("sampling_rate", "of the door; empty: not known", "run.result.rate", "Hz"),
        _text("software", "what recorded it, with its version", "run.result.software"),
        _text(
            "libraries",
            "what computed its result, with versions; empty: not known",
            "run.libraries",
        ),
        _text(
            "thresholds_changed",
            "numbers of the testbed that are not the protocol's; empty: none, or not known",
            "run.thresholds_changed",
        ),
        _text(
            "mapping_sha256",
            "equal: all signals were read alike; 16 digits; empty: not known",
            "run.mapping_digest",
        ),
        _text(
            "recording_sha256",
            "checksum of its recording; empty: not known",
            "run.recording_digest",
        ),
    ),
)

INDICATORS = TidyTable(
    "indicators",
    "one row for each run and indicator",
    (
        *WHOSE,
        *_KIND,
        _RULESET,
        _OUTCOME,
        _VALID,
        _text("indicator", "its name", "item.name"),
        _number("value", "in its unit; empty: there is none", "item.indicator.value"),
        _text("unit", "of value and uncertainties", "item.indicator.unit"),
        _text("reason", "why there is no value; empty: there is one", "item.indicator.reason"),
        _number("uncertainty", "standard; empty: not known", "item.indicator.uncertainty.u"),
        _number(
            "expanded_uncertainty",
            "of 95 in 100; empty: not known",
            "item.indicator.uncertainty.expanded",
        ),
        _number(
            "at_rest",
            "how much of the value the sensor reads at rest",
            "item.indicator.uncertainty.rest",
        ),
        _text(
            "doubts",
            "sentences, with ; between; empty: none",
            lambda row: "; ".join(row.item.indicator.doubts),
        ),
    ),
    lambda run: map(_OfIndicator._make, run.result.indicators.items()),
)

EVENTS = TidyTable(
    "events",
    "one row for each event of a run",
    (
        *WHOSE,
        _RULESET,
        _text("event", "as EUROBENCH names it", "item.event"),
        _number("time", "since 1970 (UTC)", "item.time", "s"),
        _since_start("item.time"),
    ),
    lambda run: run.result.events,
)

STEPS = TidyTable(
    "steps",
    "one row for each run and step, six of them",
    (
        *WHOSE,
        _RULESET,
        _count("step", "1 to 6", "item.step"),
        _text("name", "in words", "item.name"),
        _flag("done", "whether it counts as done", "item.done"),
        _number("time", "that counts, since 1970 (UTC); empty: not done", "item.final", "s"),
        _since_start("item.final"),
        _number("sensors", "automatic finding, since 1970; empty: none", "item.sensors", "s"),
        _flag("referee", "confirmed or denied; empty: no word on it", "item.referee.confirmed"),
        _text(
            "reason",
            "why it is not done; empty: it is",
            lambda row: None if row.item.done else row.item.reason,
        ),
    ),
    lambda run: run.result.steps,
)

RUN_TABLES = (RUNS, INDICATORS, EVENTS, STEPS)
"""From few rows to many."""


def _series(name: str, row: str, time: str, *columns: TableColumn) -> TidyTable:
    times = _number("time", "stamp, since 1970 (UTC)", time, "s")
    run = replace(_NAME, cell=lambda row: [row.run.name] * times.cell(row).size)
    return TidyTable(name, row, (run, times, _since_start(time), *columns))


_NAME = _text("run", "name of the run's folder", "run.name")

RUN = TidyTable(
    "run",
    "one row, what else the indicators hang on",
    (
        _NAME,
        *(
            replace(column, name="run_number") if column.name == "run" else column
            for column in WHOSE
        ),
        *_KIND,
        *_TASK,
        replace(_RULESET, meaning="by which rules the tables are made"),
        *_ENDING,
        _since_start(
            "run.series.rows_from", "rows_from", "since_start of the first rows that count"
        ),
        _since_start(
            "run.series.rows_until", "rows_until", "since_start of the last rows that count"
        ),
        _number("handle_zero", "force of the handle at rest", "run.result.handle_zero", "N"),
        _number(
            "touch_force", "a touch is above it", "run.scored.record.thresholds.touch_force", "N"
        ),
        _number(
            "closed_angle",
            "a closed door is below it",
            "run.scored.record.thresholds.closed_angle",
            "rad",
        ),
        _number(
            "lintel_height",
            "of the passage sensors",
            "run.scored.record.thresholds.lintel_height",
            "m",
        ),
        _number("present_height", "a robot is higher", "run.present_height", "m"),
        _number(
            "settle_time", "closed so long: step 6", "run.scored.record.thresholds.settle_time", "s"
        ),
        _number(
            "largest_gap",
            "longer intervals are gaps",
            "run.scored.record.thresholds.largest_gap",
            "s",
        ),
    ),
)

_JOINT = "run.series.rows.joint_state"

DOOR = _series(
    "door",
    "one row for each angle of the panel",
    f"{_JOINT}.time",
    _number("position", "angle; 0 = closed, positive = ccw", f"{_JOINT}.position", "rad"),
    _number("velocity", "empty beside gaps and at the ends", f"{_JOINT}.velocity", "rad/s"),
    _number("acceleration", "likewise", f"{_JOINT}.acceleration", "rad/s^2"),
    _number(
        "low_passed_acceleration",
        "as unsafety has it; likewise",
        "run.series.rows.low_passed",
        "rad/s^2",
    ),
    _number("jerk", "as smoothness has it; empty: it does not count", "run.door_jerk", "rad/s^3"),
)

HANDLE = _series(
    "handle",
    "one row for each force on the handle",
    "run.series.rows.force_time",
    _number("force", "as recorded; positive = towards ccw", "run.series.rows.force", "N"),
)


def _of_sensors(name: str) -> Callable[[RowSource], list[object]]:
    return lambda row: [getattr(sensor, name) for sensor in row.run.passage_sensors]


PASSAGE = _series(
    "passage",
    "one row for each used passage sensor and message of its strip",
    "run.series.passage.time",
    _text("side", "cw or ccw: over which side it hangs", _of_sensors("side")),
    _count("index", "0 (farthest from the hinge) to 4", _of_sensors("index")),
    _text("strip", "which strip holds it", _of_sensors("strip")),
    _count("element", "its place in the strip, 0 to 3", _of_sensors("element")),
    _number(
        "range",
        "down; inf = nothing there, empty = no reading",
        "run.series.passage.distance",
        "m",
    ),
    _number(
        "height",
        "of the obstacle; -inf = nothing there",
        lambda row: (
            row.run.scored.record.thresholds.lintel_height - row.run.series.passage.distance
        ),
        "m",
    ),
    _flag(
        "present",
        "something is there, as it counts; empty = not known yet",
        lambda row: [
            None if presence < 0 else presence
            for presence in row.run.series.passage.present.tolist()
        ],
    ),
    _flag("masked", "the panel passes under it", "run.series.passage.masked"),
)

LATCH = _series(
    "latch",
    "one row for each message of the latch sensor; none without one",
    "run.series.latch_time",
    _flag("engaged", "whether the latch is engaged", "run.series.latch_engaged"),
)

SAMPLE_TABLES = (RUN, DOOR, HANDLE, PASSAGE, LATCH)
"""In the order in which they are written."""
