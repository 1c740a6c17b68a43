"""A competition's standings for programs: csv and json."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec

from madrob_console.common.names import table_cell, valid_text
from madrob_console.pages.competition import NOTES, CompetitionStandings, statistics_of
from madrob_console.pages.tally import Tally
from madrob_console.referee.flags import serious
from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition

FORMAT = 1

ALL = "all"

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
"""Of the csv file. `flagged`: valid runs with a serious flag; `undecided`: those of them that wait
for a decision of the referee, so that a number may still change; `open_protests`: runs with an
undecided protest (the row is not final); `without_result`: current runs, and runs that the
referee has to decide on.
"""


def standings_csv(competition: CompetitionStandings) -> str:
    """One row for each team, condition (and all of them) and indicator.

    Numbers have all their digits. Empty = no value, or none that EUROBENCH reports. The expanded
    uncertainty is that of the mean: by measurement, or t std / sqrt(runs) where that is larger; of
    one run its own. A team's name that a spreadsheet would take for a formula gets an apostrophe.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for group in competition.groups:
        for team in group.overall:
            writer.writerows(_rows(competition, {"condition": ALL}, team))
        for condition, standings in group.conditions.items():
            for standing in standings:
                writer.writerows(_rows(competition, _condition(condition), standing))
    return text.getvalue()


def standings_json(competition: CompetitionStandings, software: str) -> bytes:
    return msgspec.json.encode(standings_document(competition, software)) + b"\n"


def standings_document(competition: CompetitionStandings, software: str) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "software": f"madrob-console {software}",
        "made": competition.made,
        "competition": competition.title,
        "source": competition.kind,
        "official": competition.kind == "official",
        "best_runs": competition.best or None,
        "provisional": competition.provisional,
        "protested": competition.protested,
        "open_protests": [
            {
                "folder": valid_text(run.folder),
                "subject": run.subject,
                "condition": run.condition,
                "run_number": run.run_number,
                "run_id": run.run_id,
                "filed": run.protest_filed,
            }
            for run in competition.open_protests
        ],
        "remarks": (
            *filter(None, [competition.banner]),
            *competition.remarks,
            competition.basis,
            *NOTES,
        ),
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
            for group in competition.groups
        ],
        "flagged": [
            {
                "folder": valid_text(run.folder),
                "subject": run.subject,
                "condition": run.condition,
                "run_number": run.run_number,
                "flags": serious(run.flags),
            }
            for run in competition.flagged
        ],
        "left_out": [
            {
                "folder": valid_text(run.folder),
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
                "same_run_as": valid_text(run.twin) or None,
                "why": valid_text(run.why_left_out),
            }
            for run in competition.left_out
        ],
    }


def _rows(
    competition: CompetitionStandings, condition: Mapping[str, object], tally: Tally
) -> Iterator[dict[str, object]]:
    names = {
        "ruleset": table_cell(tally.ruleset),
        "team": table_cell(tally.team),
        "testbed": table_cell("; ".join(tally.testbeds)),
        "competition": table_cell(competition.title),
    }
    of_tally = {**_tally(tally), "source": competition.kind, **names, **condition}
    for indicator, numbers in of_tally["indicators"].items():
        alike = " ".join(map(str, numbers["not_distinguishable_from"]))
        yield {**of_tally, "indicator": indicator, **numbers, "not_distinguishable_from": alike}


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
                "expanded_uncertainty": uncertainty.expanded if uncertainty else None,
                "doubts": tally.doubts.get(name, 0),
                "not_distinguishable_from": tally.alike.get(name, ()),
            }
            for name in IndicatorName
            for aggregate in [tally.aggregates.get(name)]
            for uncertainty in [aggregate.uncertainty if aggregate else None]
        },
    }
