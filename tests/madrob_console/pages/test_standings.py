"""Standings: which runs count, what a team's mean is worth, which teams cannot be told apart."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Sequence
from dataclasses import asdict

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.pages.competition import NOTES, SIGNS, competition_standings, statistics_text
from madrob_console.pages.outputs import standings_details, standings_html
from madrob_console.pages.standings_files import standings_csv, standings_json
from madrob_console.pages.tally import Aggregate, leaders, overall, standings
from madrob_console.referee.run_summary import RunSummary
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
from scoring.result import Uncertainty
from tests.madrob_console.run_folders import VALUES, summary

TIME = IndicatorName.EXECUTION_TIME
HANDLE = IndicatorName.TIME_TO_HANDLE
LEVEL = IndicatorName.CAPABILITY_LEVEL
FINITE = st.floats(allow_nan=False, allow_infinity=False)


def timed(
    time: float, *, level: int = 6, outcome: Outcome = Outcome.COMPLETED, hour: float = 0.0
) -> RunSummary:
    """A run of one team with an execution time; its time to handle is a tenth of it."""
    values = {TIME: time, HANDLE: time / 10, LEVEL: level}
    return summary(values=values, outcome=outcome, hour=hour)


RUNS = st.builds(
    summary,
    subject=st.integers(1, 2),
    condition=st.integers(1, 2),
    team=st.sampled_from(["A", "B"]),
    outcome=st.none() | st.sampled_from(Outcome),
    source=st.sampled_from(["ros", "simulated", "replay", None]),
    values=st.fixed_dictionaries(
        {}, optional={str(name): st.floats(-1e6, 1e6) for name in IndicatorName}
    ),
    problem=st.sampled_from([None, None, None, "damaged"]),
)


def test_runs_are_counted_by_how_they_ended() -> None:
    outcomes = [Outcome.COMPLETED] * 3 + [Outcome.TIMEOUT] * 2 + [Outcome.ABORTED]
    runs = [summary(outcome=outcome) for outcome in [*outcomes, Outcome.INTERRUPTED, None]]
    (one,) = standings(runs)
    assert (one.subject, one.team, one.condition) == (3, "Team 3", 7)
    counts = one.completed, one.timeout, one.aborted, one.interrupted, one.without_result
    assert counts == (3, 2, 1, 1, 1)


def test_subjects_conditions_and_rulesets_stand_apart_and_names_never_do() -> None:
    runs = [
        summary(2, 8),
        summary(2, 7),
        summary(1, 20, team="A", hour=2.0),
        summary(1, 20, team="Z", hour=1.0),
        summary(2, 7, ruleset="eurobench-2020"),
    ]
    found = [(s.subject, s.condition, s.team, s.ruleset) for s in standings(runs)]
    assert found == [
        (1, 20, "A", "protocol"),
        (2, 7, "Team 2", "eurobench-2020"),
        (2, 7, "Team 2", "protocol"),
        (2, 8, "Team 2", "protocol"),
    ]


def test_a_team_has_the_name_of_the_list_and_the_others_are_a_remark() -> None:
    names = ["Team 3", "team 3", "", "Delft", "team 3"]
    runs = [summary(3, team=name, hour=float(hour)) for hour, name in enumerate(names)]
    runs.append(summary(3, team="TEST", source="simulated", hour=9.0))  # practice names nobody
    for found in (standings, overall):
        for listed, told in (
            ({3: "Delft Walkers"}, ("Delft Walkers", ("Team 3", "Delft", "team 3"), 5)),
            ({4: "Others"}, ("team 3", ("Team 3", "Delft"), 5)),
        ):
            (team,) = found(runs, listed=listed)
            assert (team.team, team.other_names, team.completed) == told


def test_an_aggregate_has_mean_median_and_the_sample_deviation() -> None:
    for times, expected in (
        ((10.0, 20.0, 60.0), Aggregate(30.0, 20.0, 700**0.5, 10.0, 60.0, 3)),
        ((10.0,), Aggregate(10.0, 10.0, None, 10.0, 10.0, 1)),
    ):
        (standing,) = standings([timed(time) for time in times])
        assert asdict(standing.aggregates[TIME]) == pytest.approx(asdict(expected))


NO_TIME = {name: value for name, value in VALUES.items() if name != TIME}
COUNTED: dict[str, tuple[RunSummary, int, int]] = {
    "the time of a run that was not completed": (timed(300.0, outcome=Outcome.TIMEOUT), 0, 1),
    "an aborted run": (timed(99.0, outcome=Outcome.ABORTED), 0, 0),
    "an interrupted run": (timed(99.0, outcome=Outcome.INTERRUPTED), 0, 0),
    "a missing value": (summary(values=NO_TIME), 0, 1),
    "another one": (timed(20.0), 1, 1),
}


@pytest.mark.parametrize("case", COUNTED)
def test_what_enters_no_aggregate_is_left_out_and_not_taken_for_zero(case: str) -> None:
    run, times, handles = COUNTED[case]
    (alone,), (both,) = standings([run]), standings([timed(10.0), run])
    for name, count in ((TIME, times), (HANDLE, handles)):
        assert both.aggregates[name].count == 1 + count
        assert both.aggregates[name].smallest >= 1.0
        assert (name in alone.aggregates) == bool(count)


def test_official_and_simulated_runs_are_never_mixed_and_a_replay_never_counts() -> None:
    runs = [summary(source=source) for source in ("ros", "simulated", "simulated", "replay")]
    (official,), (practice,) = standings(runs), standings(runs, official=False)
    assert (official.completed, practice.completed) == (1, 2)
    assert standings(runs[3:]) == standings(runs[3:], official=False) == ()


def test_a_damaged_result_never_counts() -> None:
    runs = [summary(problem="result.json is damaged"), summary(outcome=None, problem="damaged")]
    assert standings(runs) == ()
    unfinished = summary(outcome=None, source=None, values={})
    assert standings([unfinished]) == ()  # it makes no standing of its own
    (standing,) = standings([unfinished, summary()])
    assert (standing.interrupted, standing.without_result) == (0, 1)


def test_the_best_runs_have_the_highest_level_then_completed_then_are_fast() -> None:
    runs = [
        timed(50.0, level=6),
        timed(40.0, level=6),
        timed(300.0, level=6, outcome=Outcome.TIMEOUT),
        timed(5.0, level=5, outcome=Outcome.TIMEOUT),
        timed(30.0, level=4),
        timed(1.0, outcome=Outcome.ABORTED),
    ]
    means = []
    for best in (1, 2, 3, 4, 5, 99):
        (standing,) = standings(runs, best=best)
        assert (standing.completed, standing.timeout, standing.aborted) == (3, 2, 1)
        assert standing.aggregates[HANDLE].count == min(best, 5)
        means.append(standing.aggregates[HANDLE].mean)
    assert means[:4] == pytest.approx([4.0, 4.5, 13.0, 9.875])
    assert standings(runs, best=99) == standings(runs)


def test_time_makes_no_failed_run_better_and_of_equal_ones_the_earlier_is() -> None:
    failed = [timed(t, hour=h, outcome=Outcome.TIMEOUT) for t, h in ((300.0, 1.0), (20.0, 2.0))]
    equal = [summary(values={TIME: 10.0, HANDLE: 7.0, LEVEL: 6}, hour=1.0), timed(10.0, hour=2.0)]
    for first, second in (failed, equal):
        (standing,) = standings([second, first], best=1)
        assert standing.aggregates[HANDLE].mean == pytest.approx(first.values[HANDLE])
        assert first.values[HANDLE] != second.values[HANDLE]


def test_all_conditions_are_the_mean_of_those_in_which_each_team_has_a_value() -> None:
    runs = [
        *(timed(10.0), timed(20.0), summary(3, 8, values={TIME: 60.0, LEVEL: 1})),
        summary(4, 8, values={TIME: 50.0, LEVEL: 2}),
    ]
    told = [(one.subject, one.conditions, one.completed, one.counted) for one in overall(runs)]
    assert told == [(3, (7, 8), 3, 3), (4, (8,), 1, 1)]
    assert [one.aggregates[TIME].mean for one in overall(runs)] == [60.0, 50.0]  # condition 8
    team, _ = overall(runs, best=1)  # the best of each condition
    assert (team.completed, team.counted) == (3, 2)
    (alone,) = overall(runs[:3])  # a condition of two runs weighs as much as one of one
    assert alone.aggregates[TIME].mean == pytest.approx((15.0 + 60.0) / 2)
    others = [summary(ruleset="eurobench-2020"), summary(source="simulated"), summary()]
    assert [team.ruleset for team in overall(others)] == ["eurobench-2020", "protocol"]


def test_a_team_that_is_faster_in_each_condition_is_faster_in_all() -> None:
    slow = [known(1, 10.0)] * 3 + [known(1, 30.0, condition=8)]
    fast = [known(2, 9.5)] + [known(2, 28.0, condition=8)] * 4
    one, other = (team.aggregates[TIME].mean for team in overall([*slow, *fast]))
    assert other < one


def test_the_best_of_several_runs_is_not_marked_as_like_another() -> None:
    runs = [known(1, 10.0), *(known(2, 10.0 + n) for n in range(8))]
    assert [one.alike for one in standings(runs, best=1)] == [{}, {}]


def test_all_that_are_equal_lead() -> None:
    equal = [summary(n, values={LEVEL: 3}, outcome=Outcome.TIMEOUT) for n in (1, 2)]
    lower = summary(3, values={LEVEL: 2}, outcome=Outcome.TIMEOUT)
    assert [one.subject for one in leaders(standings([*equal, lower], best=1))] == [1, 2]


@given(st.lists(FINITE, min_size=1, max_size=8))
def test_an_aggregate_lies_within_its_values(values: list[float]) -> None:
    aggregate = Aggregate.of(values)
    if aggregate is None:  # beyond the range of numbers
        assert max(map(abs, values)) > 1e150
        return
    assert aggregate.count == len(values)
    slack = 1e-9 * max(map(abs, values))
    assert aggregate.smallest - slack <= aggregate.mean <= aggregate.largest + slack
    assert aggregate.smallest <= aggregate.median <= aggregate.largest
    assert (aggregate.deviation is None) == (len(values) == 1)
    if aggregate.deviation is not None:
        assert 0 <= aggregate.deviation <= (aggregate.largest - aggregate.smallest) * 1.01 + slack


@given(st.lists(RUNS, max_size=12), st.integers(0, 4))
def test_official_standings_do_not_depend_on_runs_that_are_not(
    runs: list[RunSummary], best: int
) -> None:
    def of(runs: list[RunSummary]) -> dict[object, object]:
        found = standings(runs, best=best)
        return {(s.subject, s.condition, s.ruleset): s.aggregates for s in found if s.aggregates}

    assert of(runs) == of([run for run in runs if run.official and run.valid])


@given(st.lists(RUNS, max_size=12))
def test_every_official_run_is_counted_once(runs: list[RunSummary]) -> None:
    ended = (Outcome.COMPLETED, Outcome.TIMEOUT, Outcome.ABORTED)
    whole = [run for run in runs if run.official and run.problem is None and run.outcome in ended]
    for found in (standings(runs), overall(runs)):
        assert sum(one.completed + one.timeout + one.aborted for one in found) == len(whole)


# ---------------------------------------------------------------- told apart


def known(subject: int, time: float, expanded: float | None = 0.5, **fields: object) -> RunSummary:
    """A run with an execution time of which an uncertainty is known, or none."""
    kept = {} if expanded is None else {TIME: Uncertainty(expanded / 2, expanded)}
    told = {"values": {**VALUES, TIME: time}, "uncertainties": kept, **fields}
    return summary(subject, **told)  # type: ignore[arg-type]


def alike(runs: Sequence[RunSummary]) -> dict[int, tuple[int, ...]]:
    return {one.subject: one.alike[TIME] for one in standings(runs) if TIME in one.alike}


THREE = (known(1, 10.0), known(2, 10.9), known(3, 15.0, doubts={TIME: 2}))
"""The first two do not differ by more than their uncertainties; the third is doubted."""


SLOW = [known(1, time, 0.02) for time in (12.0, 14.0, 16.0)]  # 14.0 s, std 2.0 s
FAST = [known(2, time, 0.02) for time in (12.0, 13.5, 15.0)]  # 13.5 s, std 1.5 s
BOTH: dict[int, tuple[int, ...]] = {1: (2,), 2: (1,)}
ALIKE: dict[str, tuple[Sequence[RunSummary], dict[int, tuple[int, ...]]]] = {
    "uncertainties that overlap": (THREE, BOTH),
    "that do not": ([known(1, 10.0), known(2, 11.1)], {}),
    "shown rounded up, compared unrounded": ([known(1, 10.0, 0.31), known(2, 10.7, 0.31)], {}),
    "of three": (
        [known(1, 10.0, 2.0), known(2, 9.0, 0.1), known(3, 11.0, 0.1)],
        {1: (2, 3), 2: (1,), 3: (1,)},
    ),
    "few runs": ([known(1, 10.0), known(2, 10.8)], BOTH),
    "more runs": ([known(1, 10.0), known(2, 10.8)] * 4, {}),
    "no better than runs repeat": ([*SLOW, *FAST], BOTH),
    "of one run there is no std": ([known(1, 14.0, 0.02), known(2, 13.5, 0.02)], {}),
    "apart by more than that": ([*SLOW, *(known(2, 23.5 + n, 0.02) for n in (-1.5, 0, 1.5))], {}),
    "one unknown": ([known(1, 10.0), known(2, 10.0, None)], {}),
    "one run unknown": ([known(1, 10.0), known(2, 10.0), known(2, 10.0, None)], {}),
    "other conditions": ([known(1, 10.0), known(2, 10.0, condition=8)], {}),
    "other rules": ([known(1, 10.0), known(2, 10.0, ruleset="eurobench-2020")], {}),
}


@pytest.mark.parametrize("case", ALIKE)
def test_teams_that_nobody_can_tell_apart_are_named(case: str) -> None:
    runs, expected = ALIKE[case]
    assert alike(runs) == expected
    assert LEVEL not in standings(runs)[0].alike  # a count that has no uncertainty, and is equal


def test_the_uncertainty_of_a_mean_is_that_of_its_repeated_runs() -> None:
    one, other = standings([*SLOW, *FAST])
    spread = one.aggregates[TIME].uncertainty
    assert spread is not None
    assert spread.expanded == pytest.approx(4.31 * 2.0 / 3**0.5)  # Student's t
    assert other.aggregates[TIME].deviation == pytest.approx(1.5)
    both = overall([known(1, 10.0), known(2, 10.0)])
    assert [one.alike[TIME] for one in both] == [(2,), (1,)]
    apart = overall([known(1, 10.0), known(2, 10.0, condition=8)])
    assert [one.aggregates for one in apart] == [{}, {}]  # they have no condition in common


def test_the_mean_of_a_team_has_an_uncertainty_and_its_doubts_are_counted() -> None:
    runs = [known(1, 10.0, 0.6, doubts={TIME: 1}), known(1, 10.0, 0.8, doubts={TIME: 2})]
    (one,), (missing,) = standings(runs), standings([known(1, 0.0, values={}, doubts={TIME: 1})])
    mean = one.aggregates[TIME].uncertainty
    assert mean is not None
    assert mean.expanded == pytest.approx(0.5)
    assert (one.doubts, one.signs(TIME), one.signs(LEVEL)) == ({TIME: 3}, "?", "")
    assert (TIME in missing.aggregates, missing.doubts) == (False, {TIME: 1})


def test_means_are_marked_in_tables_pages_and_data_with_what_the_signs_mean() -> None:
    of = competition_standings(THREE, made=0.0)
    table = list(csv.DictReader(io.StringIO(standings_csv(of))))
    rows = [row for row in table if row["indicator"] == TIME and row["condition"] == "7"]
    keys = ("mean", "expanded_uncertainty", "doubts", "not_distinguishable_from")
    assert [[row[key] for key in keys] for row in rows] == [
        ["10.0", "0.5", "0", "2"],
        ["10.9", "0.5", "0", "1"],
        ["15.0", "0.5", "2", ""],
    ]
    others = next(row for row in table if row["indicator"] == LEVEL)
    assert (others["expanded_uncertainty"], others["doubts"]) == ("", "0")
    document = json.loads(standings_json(of, "1"))
    first = document["rulesets"][0]["conditions"][0]["teams"][0]["indicators"][TIME]
    assert [first[key] for key in keys[1:]] == [0.5, 0, [2]]
    text = list(standings_details(of))
    lines = text[text.index("mean") + 1 :][:7]
    assert max(map(len, lines)) <= 80
    cells = [line.split()[1] for line in (*lines[:3], *lines[4:])]
    assert (lines[3], cells) == ("+-", ["10.0~", "10.9~", "15.0?", *["0.5"] * 3])
    assert f"{SIGNS}." in text
    page = standings_html(of, "1")
    for words in (
        "<b>10.0~</b><small>[+]- 0.5<br>[^/]*<br>~ 2</small>",
        "<b>15.0[?]</b><small>[+]- 0.5<br>[^/]*<br>2 doubts</small>",
        re.escape(SIGNS),
    ):
        assert re.search(words, page), words


@pytest.mark.parametrize("expanded", [0.0, 5e-324, 1e-9, 1e9, 1.7e308])
def test_whatever_a_file_says_the_standings_stay_readable(expanded: float) -> None:
    runs = [known(subject, 10.0, expanded) for subject in (1, 1, 2)]
    of = competition_standings(runs, made=0.0)
    text = list(standings_details(of))
    table = text.index("mean")
    assert max(map(len, text[table : table + 6])) <= 80
    assert "10" in text[table + 1]
    assert json.loads(standings_json(of, "1"))
    assert (standings_html(of, "1") != "", standings_csv(of) != "") == (True, True)


def test_all_statistics_have_the_digits_that_the_mean_s_uncertainty_leaves() -> None:
    times = (45.607, 46.1234, 46.5)
    (one,) = standings([known(1, time, 1.7) for time in times])
    told = {"mean": "46", "median": "46", "std": "0.4"}  # which often is less than a unit
    assert statistics_text(one.aggregates[TIME], TIME) == told
    (one,) = standings([known(1, time, None) for time in times])
    assert statistics_text(one.aggregates[TIME], TIME)["median"] == "46.12"
    assert statistics_text(None, TIME) == {}


def test_uncertainties_are_shown_rounded_up_and_compared_unrounded_as_is_said() -> None:
    runs, _ = ALIKE["shown rounded up, compared unrounded"]
    text = list(standings_details(competition_standings(runs, made=0.0)))
    assert text[text.index("+-") + 1].split()[1] == "0.4"  # which would overlap
    assert "within unrounded uncertainty" in SIGNS
    assert any(
        "rounded up: by measurement, or Student's t std / sqrt(runs)" in note for note in NOTES
    )
