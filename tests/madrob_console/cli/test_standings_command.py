"""`madrob standings`: the table, csv, json and html of a results folder."""

from __future__ import annotations

import csv
import html
import io
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from madrob_console.cli.output import BAD_INPUT
from madrob_console.pages.competition import CompetitionStandings, competition_standings
from madrob_console.pages.outputs import standings_details, standings_html
from madrob_console.pages.standings_files import COLUMNS, standings_csv, standings_json
from madrob_console.referee.flags import Flag, FlagKind, FlagWeight
from madrob_console.referee.run_summary import RunSummary
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.pages.competition_runs import HOSTILE
from tests.madrob_console.run_folders import EPOCH, UNDECIDED_START, VALUES, summary, write

TIME = IndicatorName.EXECUTION_TIME
FORCE = IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION


def timed(seconds: float, **fields: Any) -> RunSummary:  # noqa: ANN401  as `summary`
    return summary(values={**VALUES, TIME: seconds}, **fields)


RUNS = (
    timed(10.0, run_number=1, final=True, team_word="acknowledged"),
    timed(20.0, run_number=2, final=True, team_word="protested"),
    timed(300.0, run_number=3, outcome=Outcome.TIMEOUT),
    timed(40.0, run_number=1, condition=12),
    timed(1.0, run_number=4, outcome=Outcome.ABORTED, reason="a child ran in"),
    timed(2.0, run_number=5, outcome=Outcome.INTERRUPTED, reason="power cut"),
    timed(3.0, run_number=6, source="simulated"),
    timed(4.0, run_number=7, source="replay"),
    timed(30.0, subject=2, run_number=1),
)


def found(*runs: RunSummary, **how: Any) -> CompetitionStandings:  # noqa: ANN401
    return competition_standings(runs or RUNS, made=EPOCH, **how)


def rows(of: CompetitionStandings) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(standings_csv(of))))


def document(of: CompetitionStandings) -> dict[str, Any]:
    decoded: dict[str, Any] = json.loads(standings_json(of, "9.9"))
    return decoded


def words(of: CompetitionStandings) -> str:
    """What a reader sees of the page, on one line."""
    page = standings_html(of, "9.9").partition("<body>")[2]
    return " ".join(re.sub("<[^>]*>", " ", page).split())


@pytest.fixture
def results(tmp_path: Path) -> Path:
    root = tmp_path / "results"
    for run in RUNS:
        write(root, run)
    return root


# ---------------------------------------------------------------- what counts


def test_the_csv_has_a_row_for_each_team_condition_and_indicator() -> None:
    table = rows(found())
    assert tuple(table[0]) == COLUMNS
    places = [(row["condition"], row["subject"], row["indicator"]) for row in table]
    assert places == [
        (condition, subject, name)
        for condition, subject in (("all", "2"), ("all", "3"), ("7", "3"), ("7", "2"), ("12", "3"))
        for name in IndicatorName
    ]
    assert {row["unit"] for row in table if row["indicator"] == TIME} == {"s"}
    assert {row["indicator"] for row in table if row["min"] and row["max"]} == {
        "unsafety_of_door_operation",
        "smoothness_of_door_actuation",
        "roughness_of_door_actuation",
        "capability_level",
    }


@pytest.mark.parametrize(
    ("best", "condition", "indicator", "told"),
    [
        # execution time is of completed runs, others are of all valid ones
        (0, "7", TIME, {"runs": "2", "mean": "15.0", "median": "15.0", "completed": "2"}),
        (0, "7", TIME, {"timeout": "1", "invalid": "1", "interrupted": "1", "std": f"{50**0.5}"}),
        (0, "7", FORCE, {"runs": "3"}),
        (0, "12", TIME, {"std": ""}),  # of one run
        (0, "all", TIME, {"runs": "2", "mean": "15.0"}),  # both teams have condition 7 alone
        (1, "7", TIME, {"mean": "10.0"}),
        (1, "all", TIME, {"mean": "10.0", "completed": "3"}),
    ],
)
def test_a_cell_of_a_team_is_over_these_runs(
    best: int, condition: str, indicator: str, told: dict[str, str]
) -> None:
    of = found(best=best)
    (row,) = [
        row
        for row in rows(of)
        if (row["condition"], row["subject"], row["indicator"]) == (condition, "3", indicator)
    ]
    assert {name: as_number(row[name]) for name in told} == pytest.approx(
        {name: as_number(value) for name, value in told.items()}
    )
    named = f"the best {best} valid official runs of each team in each condition"
    assert (named in words(of)) == bool(best)


def as_number(text: str) -> float:
    return float(text) if text else -1.0


REMARK = Flag(FlagKind.FALSE_START, "1 false start accepted", FlagWeight.REMARK)
DENIED = Flag(FlagKind.DENIED_STEP, "step 4 denied", FlagWeight.CAUTION)
FLAGGED = (
    timed(10.0, run_number=1, flags=(UNDECIDED_START, REMARK)),
    timed(20.0, run_number=2, flags=(DENIED,)),
    timed(30.0, subject=2, run_number=1, flags=(REMARK,)),
)
TOLD: dict[str, tuple[Sequence[RunSummary], bool, list[str]]] = {
    "runs that do not count, with their reason": (
        (
            *RUNS,
            summary(run_number=9, outcome=None, source=None, competition=None),
            summary(run_number=8, problem="result.json is damaged"),
        ),
        True,
        [
            "run 4 of subject 3 in condition 7, ",
            ": INVALID : a child ran in",
            *("power cut", "no result yet", "result.json is damaged"),
        ],
    ),
    "that nobody gave a reason": (
        (timed(1.0, outcome=Outcome.ABORTED), timed(1.0, outcome=Outcome.INTERRUPTED)),
        True,
        ["the referee gave no reason", "the machine failed"],
    ),
    "what is not final, and protested": (
        RUNS,
        True,
        ["Not final: 3 of the valid runs.", "PROTESTED by the team: 1 of the valid runs."],
    ),
    "an open protest": (
        (timed(10.0, protest_filed=EPOCH),),
        True,
        ["PROTEST open against run 1 of subject 3 in condition 7: NOT FINAL until it is decided."],
    ),
    "that it is practice": (RUNS, False, ["PRACTICE: not official."]),
    "that rulesets stand apart": (
        (*RUNS, timed(99.0, ruleset="eurobench-2020")),
        True,
        ["stand apart, do not compare them: eurobench-2020, protocol"],
    ),
    "what a decision hangs on": (
        FLAGGED,
        True,
        [
            "UNDECIDED: 1 of the valid runs, for the referee to decide.",
            "with flags",
            "1 false start UNDECIDED (handle touched)",
        ],
    ),
}


@pytest.mark.parametrize("what", TOLD)
def test_page_and_json_tell(what: str) -> None:
    runs, official, told = TOLD[what]
    of = found(*runs, official=official)
    said = words(of)
    assert [one for one in told if one not in said] == []
    assert {left["why"] for left in document(of)["left_out"]} == {
        left.why_left_out for left in of.left_out
    }
    assert [one for one in of.remarks if one not in html.unescape(said)] == []
    assert ("PRACTICE" in said + standings_csv(of)) is not official
    flagged = any("with flags" in line for line in standings_details(of))
    assert flagged == (runs is FLAGGED)


# ---------------------------------------------------------------- the files


def test_each_file_says_how_many_runs_are_flagged_and_wait_for_a_decision() -> None:
    of = found(*FLAGGED)
    (line,) = (line for line in standings_details(of) if "handle touched" in line)
    assert line.startswith("  run 1 of subject 3")
    told = document(of)
    flagged = [(one["run_number"], one["flags"][0]["undecided"]) for one in told["flagged"]]
    teams = told["rulesets"][0]["overall"]
    counts = {team["subject"]: (team["flagged"], team["undecided"]) for team in teams}
    in_rows = {int(r["subject"]): (int(r["flagged"]), int(r["undecided"])) for r in rows(of)}
    assert (flagged, counts, in_rows) == ([(1, True), (2, False)], *[{2: (0, 0), 3: (2, 1)}] * 2)


def test_names_and_reasons_have_no_power_anywhere() -> None:
    hostile = {"team": f"={HOSTILE}", "reason": HOSTILE, "competition": HOSTILE}
    of = found(timed(1.0, **hostile), timed(1.0, outcome=Outcome.ABORTED, **hostile))
    page = standings_html(of, "")
    assert ("<script" in page, "&lt;script&gt;" in page) == (False, True)
    assert not {"\x1b", "\u202e"} & set(page + standings_csv(of))
    assert all(row["team"].startswith("'=") for row in rows(of))


@settings(max_examples=40)
@given(
    st.lists(
        st.builds(
            timed,
            st.floats(0, 1e9),
            subject=st.integers(1, 3),
            condition=st.integers(1, 20),
            team=st.text(st.characters(exclude_categories=["Cs"]), max_size=20),
            outcome=st.sampled_from(Outcome),
            source=st.sampled_from(["ros", "simulated"]),
            ruleset=st.sampled_from(["protocol", "eurobench-2020"]),
            reason=st.text(st.characters(exclude_categories=["Cs"]), max_size=20),
        ),
        max_size=8,
    ),
    st.booleans(),
    st.integers(0, 3),
)
def test_whatever_was_run_csv_json_and_page_tell_of_the_same_teams(
    runs: list[RunSummary], official: bool, best: int
) -> None:
    of = competition_standings(runs, made=EPOCH, official=official, best=best)
    counted = [run for run in runs if run.official is official]
    told = document(of)
    teams = [team for group in told["rulesets"] for team in group["overall"]]
    assert sum(t["completed"] + t["timeout"] for t in teams) == sum(r.valid for r in counted)
    assert len(told["left_out"]) == sum(not run.valid for run in counted)
    table = rows(of)
    assert len([row for row in table if row["condition"] == "all"]) == len(IndicatorName) * len(
        teams
    )
    assert standings_html(of, "").count('<th scope="row">') * len(IndicatorName) == len(table)
    means = [team["indicators"][TIME]["mean"] for team in teams]
    overall = [r["mean"] for r in table if r["condition"] == "all" and r["indicator"] == TIME]
    assert [float(mean) if mean else None for mean in overall] == means


# ---------------------------------------------------------------- the command


def test_without_a_file_each_condition_is_a_table_that_its_leader_begins(
    results: Path, madrob: Madrob
) -> None:
    write(results, summary(4, outcome=Outcome.TIMEOUT, values={**VALUES, "capability_level": 3}))
    (results / summary(2, run_number=9, hour=9).folder).mkdir()
    lines = [" ".join(line.split()) for line in madrob("standings", results).splitlines()]
    assert "Runs without a result yet: 1." in lines
    assert "MADROB standings Autumn Cup" in lines
    assert "Each team's best run: level, then time. The protocol makes no ranking." in lines
    at = lines.index("Condition 7, Constant Force: push the door, from side CCW to side CW")
    assert lines[at + 1 : at + 5] == [
        "team level exec s runs",
        "3 Team 3 6 10.00 3",
        "2 Team 2 6 30.00 1",
        "4 Team 4 3 timeout 1",
    ]
    assert "3 Team 3 6 40.00 1" in lines[at + 5 :]
    assert "Runs that do not count: 2; --details gives the reasons." in lines


def test_a_file_goes_where_it_shall_else_to_standard_output(
    results: Path, tmp_path: Path, madrob: Madrob
) -> None:
    file = tmp_path / "standings"
    for kind, begin in (("csv", "source,ruleset,cond"), ("json", "{"), ("html", "<!DOCTYPE html>")):
        assert madrob(f"standings --{kind} --output", file, results) == f"{file}\n"
        shown = madrob(f"standings --{kind}", results)
        assert (shown.startswith(begin), file.read_text().startswith(begin)) == (True, True)
        assert kind != "csv" or shown == file.read_text() == standings_csv(found())
    assert not list(tmp_path.glob(".*part"))


def test_the_settings_say_how_many_runs_count_and_what_teams_are_called(
    results: Path, tmp_path: Path, madrob: Madrob
) -> None:
    teams, settings = tmp_path / "teams.csv", tmp_path / "madrob.toml"
    teams.write_text("3,Delft Walkers\n")
    settings.write_text(f'[competition]\nteams_file = "{teams}"\nbest_runs = 1\n')
    line = f"standings --settings {settings}"
    assert "Over the best 1 valid official runs" in madrob(f"{line} --details", results)
    assert "Over all valid official runs." in madrob(f"{line} --best 0", results)
    for named in (line, f"standings --teams {teams}"):
        out = madrob(named, results)
        assert ("  3 Delft Walkers  " in out, "  2 Team 2  " in out) == (True, True)


@pytest.mark.parametrize("place", ["", "practice"])
def test_a_damaged_run_is_named_on_the_side_where_it_lies_and_the_rest_goes_on(
    results: Path, madrob: Madrob, place: str
) -> None:
    write(results, summary(run_number=12, source="simulated"))
    write(results / place, summary(run_number=11)).write_text("{")
    for side, teams in (("", 2), ("practice", 1)):
        said = madrob.say("standings --json", results, *(["--practice"] if side else []))
        told = [line for line in said.err.splitlines() if re.match("madrob: .*_run_011_", line)]
        assert (said.code, len(told)) == ((BAD_INPUT, 1) if side == place else (0, 0))
        assert all("damaged" in line for line in told)
        out = json.loads(said.out)
        assert len(out["rulesets"][0]["overall"]) == teams
        assert any(run["run_number"] == 11 for run in out["left_out"]) == (side == place)


def test_a_folder_without_runs_gives_empty_standings(tmp_path: Path, madrob: Madrob) -> None:
    for option in ("", "--html"):
        assert "No run counts yet." in madrob(f"standings {option} --results", tmp_path)
