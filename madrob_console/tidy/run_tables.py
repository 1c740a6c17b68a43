"""The tables of any number of runs: which there are, and what stands in each column."""

from __future__ import annotations

from madrob_console.tidy.tidy_table import CellKind, TidyColumn, TidyTable

WHOSE = (
    TidyColumn("subject", CellKind.COUNT, "", "number of the team"),
    TidyColumn("team", CellKind.TEXT, "", "its name; empty: it has none"),
    TidyColumn("condition", CellKind.COUNT, "", "number of the condition, 1 to 20"),
    TidyColumn("run", CellKind.COUNT, "", "number of the repetition"),
    TidyColumn("run_id", CellKind.TEXT, "", "which run of all testbeds: the key to join tables"),
    TidyColumn("testbed", CellKind.TEXT, "", "name of the testbed; empty: it had none"),
    TidyColumn("competition", CellKind.TEXT, "", "its name; empty: none was set"),
)
"""Of every table: whose run it is, and which."""

TASK = (
    TidyColumn("benchmark_type", CellKind.TEXT, "", "how the door is braked"),
    TidyColumn("opening_side", CellKind.TEXT, "", "cw or ccw: to where the door opens"),
    TidyColumn("starting_side", CellKind.TEXT, "", "cw or ccw: where the robot starts"),
    TidyColumn("destination_side", CellKind.TEXT, "", "cw or ccw: where it has to go"),
)
"""What the condition is."""

_OUTCOME = TidyColumn("outcome", CellKind.TEXT, "", "how the run ended")

COURSE = (
    TidyColumn("lock_detection", CellKind.TEXT, "", "what decides step 6"),
    _OUTCOME,
    TidyColumn("start", CellKind.NUMBER, "s", "of the run, since 1970 (UTC)"),
    TidyColumn("stop", CellKind.NUMBER, "s", "likewise; empty: it was cut off"),
    TidyColumn("duration", CellKind.NUMBER, "s", "from start to stop; empty: likewise"),
)
"""When it was and how it ended."""

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
"""All of them, from few rows to many."""

UNREADABLE = TidyTable(
    "unreadable",
    "one row for each run that cannot be read",
    (
        TidyColumn("place", CellKind.TEXT, "", "path of its folder or bag"),
        TidyColumn("reason", CellKind.TEXT, "", "why, in words"),
    ),
)
"""Beside the tables of runs that are scored for them."""
