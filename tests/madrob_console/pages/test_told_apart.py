"""Teams whose means do not differ by more than is known of them are marked so, everywhere."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Sequence

import pytest

from madrob_console.archive.history import RunSummary
from madrob_console.pages.competition import NOTES, SIGNS, competition_standings, statistics_text
from madrob_console.pages.outputs import (
    standings_csv,
    standings_details,
    standings_html,
    standings_json,
)
from madrob_console.pages.tally import overall, standings, subjects_text
from scoring.indicator_table import IndicatorName
from scoring.result import Uncertainty
from tests.madrob_console.run_folders import VALUES, summary

TIME = IndicatorName.EXECUTION_TIME
LEVEL = IndicatorName.CAPABILITY_LEVEL


def timed(subject: int, time: float, expanded: float | None = 0.5, **fields: object) -> RunSummary:
    """A run with an execution time of which an uncertainty is known, or none."""
    known = {} if expanded is None else {TIME: Uncertainty(expanded / 2, expanded)}
    told = {"values": {**VALUES, TIME: time}, "uncertainties": known, **fields}
    return summary(subject, **told)  # type: ignore[arg-type]


def alike(runs: Sequence[RunSummary]) -> dict[int, tuple[int, ...]]:
    return {one.subject: one.alike[TIME] for one in standings(runs) if TIME in one.alike}


THREE = (timed(1, 10.0), timed(2, 10.9), timed(3, 15.0, doubts={TIME: 2}))
"""The first two do not differ by more than their uncertainties; the third is doubted."""


def test_teams_whose_uncertainties_overlap_are_not_distinguishable() -> None:
    assert alike(THREE) == {1: (2,), 2: (1,)}
    assert alike([timed(1, 10.0), timed(2, 11.1)]) == {}
    wide = [timed(1, 10.0, 2.0), timed(2, 9.0, 0.1), timed(3, 11.0, 0.1)]
    assert alike(wide) == {1: (2, 3), 2: (1,), 3: (1,)}


def test_more_runs_tell_teams_apart() -> None:
    runs = [timed(subject, time) for subject, time in ((1, 10.0), (2, 10.8))]
    assert alike(runs) == {1: (2,), 2: (1,)}
    assert alike(runs * 4) == {}


def test_teams_are_told_apart_no_better_than_their_runs_repeat() -> None:
    slow = [timed(1, time, 0.02) for time in (12.0, 14.0, 16.0)]  # 14.0 s, std 2.0 s
    fast = [timed(2, time, 0.02) for time in (12.0, 13.5, 15.0)]  # 13.5 s, std 1.5 s
    assert alike([*slow, *fast]) == {1: (2,), 2: (1,)}
    (one, other) = standings([*slow, *fast])
    known = one.aggregates[TIME].uncertainty
    assert known is not None
    assert known.expanded == pytest.approx(2 * 2.0 / 3**0.5)
    assert other.aggregates[TIME].deviation == pytest.approx(1.5)
    assert alike([timed(1, 14.0, 0.02), timed(2, 13.5, 0.02)]) == {}  # of one run there is no std
    assert alike([*slow, *(timed(2, time + 6.0, 0.02) for time in (12.0, 13.5, 15.0))]) == {}


def test_of_a_team_without_a_known_uncertainty_nothing_is_said() -> None:
    assert alike([timed(1, 10.0), timed(2, 10.0, None)]) == {}
    assert alike([timed(1, 10.0), timed(2, 10.0), timed(2, 10.0, None)]) == {}
    (one, _) = standings([timed(1, 10.0), timed(2, 10.0)])
    assert LEVEL not in one.alike  # a count that has none, and is equal


def test_only_teams_beside_each_other_are_compared() -> None:
    assert alike([timed(1, 10.0), timed(2, 10.0, condition=8)]) == {}
    assert alike([timed(1, 10.0), timed(2, 10.0, ruleset="eurobench-2020")]) == {}
    both = overall([timed(1, 10.0), timed(2, 10.0, condition=8)])
    assert [one.alike[TIME] for one in both] == [(2,), (1,)]


def test_the_mean_of_a_team_has_an_uncertainty_and_its_doubts_are_counted() -> None:
    runs = [timed(1, 10.0, 0.6, doubts={TIME: 1}), timed(1, 10.1, 0.8, doubts={TIME: 2})]
    (one,) = standings(runs)
    known = one.aggregates[TIME].uncertainty
    assert known is not None
    assert known.expanded == pytest.approx(0.5)
    assert one.doubts == {TIME: 3}
    assert (one.signs(TIME), one.signs(LEVEL)) == ("?", "")


def test_a_doubt_on_a_missing_value_counts_too() -> None:
    (one,) = standings([timed(1, 0.0, values={}, doubts={TIME: 1})])
    assert TIME not in one.aggregates
    assert one.doubts == {TIME: 1}


def test_the_csv_has_columns_of_it_and_undecorated_numbers() -> None:
    of = competition_standings(THREE, made=0.0)
    table = list(csv.DictReader(io.StringIO(standings_csv(of))))
    rows = [row for row in table if row["indicator"] == TIME and row["condition"] == "7"]
    assert [row["mean"] for row in rows] == ["10.0", "10.9", "15.0"]
    assert [row["expanded_uncertainty"] for row in rows] == ["0.5"] * 3
    assert [row["doubts"] for row in rows] == ["0", "0", "2"]
    assert [row["not_distinguishable_from"] for row in rows] == ["2", "1", ""]
    others = next(row for row in table if row["indicator"] == LEVEL)
    assert (others["expanded_uncertainty"], others["doubts"]) == ("", "0")


def test_the_json_has_the_same() -> None:
    document = json.loads(standings_json(competition_standings(THREE, made=0.0), "1"))
    teams = document["rulesets"][0]["conditions"][0]["teams"]
    first = teams[0]["indicators"][TIME]
    assert (first["expanded_uncertainty"], first["doubts"]) == (0.5, 0)
    assert first["not_distinguishable_from"] == [2]


def test_the_table_marks_means_and_says_what_the_signs_mean() -> None:
    text = list(standings_details(competition_standings(THREE, made=0.0)))
    table = text[text.index("mean") + 1 :]
    assert max(map(len, table[:7])) <= 80
    assert [line.split()[1] for line in table[:3]] == ["10.0~", "10.9~", "15.0?"]
    assert table[3] == "+-"
    assert [line.split()[1] for line in table[4:7]] == ["0.5"] * 3
    assert f"{SIGNS}." in text


def test_the_page_names_the_teams_that_a_mean_does_not_differ_from() -> None:
    page = standings_html(competition_standings(THREE, made=0.0), "1")
    assert re.search("<b>10.0~</b><small>[+]- 0.5<br>[^/]*<br>~ 2</small>", page)
    assert re.search("<b>15.0[?]</b><small>[+]- 0.5<br>[^/]*<br>2 doubts</small>", page)
    assert SIGNS in page


@pytest.mark.parametrize("expanded", [0.0, 5e-324, 1e-9, 1e9, 1.7e308])
def test_whatever_a_file_says_the_standings_stay_readable(expanded: float) -> None:
    runs = [timed(subject, 10.0, expanded) for subject in (1, 1, 2)]
    of = competition_standings(runs, made=0.0)
    text = list(standings_details(of))
    table = text.index("mean")
    assert max(map(len, text[table : table + 6])) <= 80
    assert "10" in text[table + 1]
    json.loads(standings_json(of, "1"))
    assert standings_html(of, "1")
    assert standings_csv(of)


def test_of_many_teams_the_first_are_named() -> None:
    assert subjects_text((2, 5)) == "2, 5"
    assert subjects_text(tuple(range(1, 10))) == "1, 2, 3, 4 and 5 more"


def test_all_statistics_have_the_digits_that_the_mean_s_uncertainty_leaves() -> None:
    times = (45.607, 46.1234, 46.5)
    (one,) = standings([timed(1, time, 1.7) for time in times])
    told = {"mean": "46", "median": "46", "std": "0.4"}  # which often is less than a unit
    assert statistics_text(one.aggregates[TIME], TIME) == told
    (one,) = standings([timed(1, time, None) for time in times])
    assert statistics_text(one.aggregates[TIME], TIME)["median"] == "46.12"
    assert statistics_text(None, TIME) == {}


def test_what_is_shown_rounded_up_is_compared_unrounded_and_the_legend_says_so() -> None:
    runs = [timed(1, 10.0, 0.31), timed(2, 10.7, 0.31)]  # shown as +- 0.4, which would overlap
    of = competition_standings(runs, made=0.0)
    text = list(standings_details(of))
    assert text[text.index("+-") + 1].split()[1] == "0.4"
    assert alike(runs) == {}
    assert "unrounded +- overlap" in SIGNS
    assert any("rounded up: by measurement, or 2 std / sqrt(runs)" in note for note in NOTES)
