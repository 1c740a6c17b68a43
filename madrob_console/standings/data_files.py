"""A competition's standings for programs: csv and json."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec

from madrob_console.names import terminal_safe
from madrob_console.referee.flags import weighty
from madrob_console.report.explanations import PRACTICE_STANDINGS
from madrob_console.standings.competition import NOTES, CompetitionStandings, statistics_of
from madrob_console.standings.tally import Tally
from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition

FORMAT = 1
"""Version of the layout of the json file."""

ALL = "all"
"""Stands in the csv file for all conditions together."""

COLUMNS = (
    *("source", "ruleset", "condition", "benchmark_type", "opening_side", "starting_side"),
    *(
        "subject",
        "team",
        "testbed",
        "competition",
        "completed",
        "timeout",
        "invalid",
        "interrupted",
        "void",
    ),
    *("flagged", "undecided"),
    *("indicator", "unit", "runs", "mean", "median", "std", "min", "max"),
    *("expanded_uncertainty", "doubts", "not_distinguishable_from", "open_protests"),
    "without_result",
)
"""Of the csv file. `flagged` are valid runs with a flag that weighs, `undecided` those of them that
wait for a decision of the referee: a number of theirs may still change. `open_protests` are runs
with a protest that is not decided: the row is not final. `without_result` are runs that go on, or
that the referee has to decide on."""

_FORMULA = ("=", "+", "-", "@")


def standings_csv(found: CompetitionStandings) -> str:
    """One row for each team, condition (and all of them) and indicator, comma-separated.

    A row names its unit and a filter of a spreadsheet on condition and indicator shows a table of
    teams; a row for each team would have forty columns of numbers. Numbers have all their digits.
    Empty = no value, or none that EUROBENCH tells. The expanded uncertainty is that of the mean: by
    measurement, or 2 std / sqrt(runs) where that is larger; of one run its own. A team is not
    distinguishable from the subjects that are named. A team's name that a spreadsheet would take
    for a formula gets an apostrophe before it.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for group in found.groups:
        for team in group.overall:
            writer.writerows(_rows(found, {"condition": ALL}, team))
        for condition, standings in group.conditions.items():
            for standing in standings:
                writer.writerows(_rows(found, _condition(condition), standing))
    return text.getvalue()


def standings_json(found: CompetitionStandings, software: str) -> bytes:
    """All of it, with units and with the runs that are left out and why.

    Args:
        found: the standings.
        software: the version that makes the file.
    """
    document = {
        "format": FORMAT,
        "software": f"madrob-console {software}",
        "made": found.made,
        "competition": found.title,
        "source": _source(found),
        "official": found.official,
        "best_runs": found.best or None,
        "provisional": found.provisional,
        "protested": found.protested,
        "open_protests": [
            {
                "folder": run.folder,
                "subject": run.subject,
                "condition": run.condition,
                "run_number": run.run_number,
                "run_id": run.run_id,
                "due": run.protest_due,
            }
            for run in found.open_protests
        ],
        "remarks": (*_warning(found), *found.remarks, found.basis, *NOTES),
        "units": {name: name.spec.unit for name in IndicatorName},
        "rulesets": [
            {
                "ruleset": group.ruleset,
                "overall": [
                    {"conditions": tally.conditions, **_tally(tally)} for tally in group.overall
                ],
                "conditions": [
                    {**_condition(condition), "teams": [_tally(team) for team in standings]}
                    for condition, standings in group.conditions.items()
                ],
            }
            for group in found.groups
        ],
        "flagged": [
            {
                "folder": run.folder,
                "subject": run.subject,
                "condition": run.condition,
                "run_number": run.run_number,
                "flags": weighty(run.flags),
            }
            for run in found.flagged
        ],
        "left_out": [
            {
                "folder": run.folder,
                "subject": run.subject,
                "team": run.team,
                "condition": run.condition,
                "run_number": run.run_number,
                "start": run.started,
                "outcome": run.outcome,
                "void": run.voided,
                "damaged": run.problem is not None,
                "run_id": run.run_id,
                "testbed": run.testbed,
                "same_run_as": run.twin or None,
                "why": why,
            }
            for run, why in found.left_out
        ],
    }
    return msgspec.json.format(msgspec.json.encode(document), indent=2) + b"\n"


def _rows(
    found: CompetitionStandings, condition: Mapping[str, object], tally: Tally
) -> Iterator[dict[str, object]]:
    """The cells by column, and more that the csv file has no column for."""
    names = {
        "ruleset": _cell(tally.ruleset),
        "team": _cell(tally.team),
        "testbed": _cell("; ".join(tally.testbeds)),
        "competition": _cell(found.title),
    }
    told = {**_tally(tally), "source": _source(found), **names, **condition}
    for indicator, numbers in told["indicators"].items():
        alike = " ".join(map(str, numbers["not_distinguishable_from"]))
        yield {**told, "indicator": indicator, **numbers, "not_distinguishable_from": alike}


def _condition(condition: Condition) -> dict[str, object]:
    return {
        "condition": condition.number,
        "benchmark_type": condition.benchmark_type,
        "opening_side": condition.opening_side,
        "starting_side": condition.starting_side,
    }


def _tally(tally: Tally) -> dict[str, Any]:
    return {
        "subject": tally.subject,
        "team": tally.team,
        "other_names": tally.other_names,
        "testbeds": tally.testbeds,
        "completed": tally.completed,
        "timeout": tally.timeout,
        "invalid": tally.aborted,
        "void": tally.voided,
        "interrupted": tally.interrupted,
        "counted": tally.counted,
        "flagged": tally.flagged,
        "undecided": tally.undecided,
        "open_protests": tally.open_protests,
        "without_result": tally.without_result,
        "indicators": {
            name: {
                "unit": name.spec.unit,
                "runs": aggregate.count if aggregate else 0,
                **statistics_of(aggregate, name),
                "expanded_uncertainty": known.expanded if known else None,
                "doubts": tally.doubts.get(name, 0),
                "not_distinguishable_from": tally.alike.get(name, ()),
            }
            for name in IndicatorName
            for aggregate in [tally.aggregates.get(name)]
            for known in [aggregate.uncertainty if aggregate else None]
        },
    }


def _source(found: CompetitionStandings) -> str:
    return "official" if found.official else "practice"


def _warning(found: CompetitionStandings) -> tuple[str, ...]:
    return () if found.official else (PRACTICE_STANDINGS,)


def _cell(text: str) -> str:
    """A name on one line that no spreadsheet takes for a formula."""
    plain = terminal_safe(text)
    return f"'{plain}" if plain.startswith(_FORMULA) else plain
