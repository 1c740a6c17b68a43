from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.archive.history import RunSummary
from madrob_console.pages.tally import Aggregate, overall, standings
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
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
    (standing,) = standings(runs)
    assert (standing.subject, standing.team, standing.condition) == (3, "Team 3", 7)
    assert (standing.completed, standing.timeout, standing.aborted) == (3, 2, 1)
    assert (standing.interrupted, standing.without_result) == (1, 1)


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
    for found in (standings, overall):
        (team,) = found(runs, listed={3: "Delft Walkers"})
        assert team.team == "Delft Walkers"
        assert team.other_names == ("Team 3", "Delft", "team 3")
        assert team.completed == 5
        (team,) = found(runs, listed={4: "Others"})
        assert (team.team, team.other_names) == ("team 3", ("Team 3", "Delft"))


def test_the_name_of_a_practice_run_is_none_of_the_official_standings() -> None:
    runs = [summary(3, team="Delft"), summary(3, team="TEST", source="simulated", hour=1.0)]
    (team,) = overall(runs)
    assert (team.team, team.other_names) == ("Delft", ())


def test_an_aggregate_has_mean_median_and_the_sample_deviation() -> None:
    (standing,) = standings([timed(10.0), timed(20.0), timed(60.0)])
    aggregate = standing.aggregates[TIME]
    assert aggregate.mean == pytest.approx(30.0)
    assert aggregate.median == 20.0
    assert aggregate.deviation == pytest.approx(700**0.5)
    assert (aggregate.smallest, aggregate.largest, aggregate.count) == (10.0, 60.0, 3)


def test_one_run_has_no_deviation() -> None:
    (standing,) = standings([timed(10.0)])
    assert standing.aggregates[TIME] == Aggregate(10.0, 10.0, None, 10.0, 10.0, 1)


def test_the_execution_time_is_that_of_completed_runs_only() -> None:
    (standing,) = standings([timed(10.0), timed(300.0, outcome=Outcome.TIMEOUT)])
    assert standing.aggregates[TIME].count == 1
    assert standing.aggregates[TIME].mean == 10.0
    assert standing.aggregates[HANDLE].count == 2
    (only,) = standings([timed(300.0, outcome=Outcome.TIMEOUT)])
    assert TIME not in only.aggregates


@pytest.mark.parametrize("outcome", [Outcome.ABORTED, Outcome.INTERRUPTED])
def test_the_indicators_of_a_run_that_does_not_count_enter_nothing(outcome: Outcome) -> None:
    (standing,) = standings([timed(10.0), timed(99.0, outcome=outcome)])
    assert standing.aggregates[HANDLE].count == 1
    (alone,) = standings([timed(99.0, outcome=outcome)])
    assert alone.aggregates == {}


def test_a_missing_value_is_left_out_and_not_taken_for_zero() -> None:
    without = {name: value for name, value in VALUES.items() if name != "passage_time"}
    (standing,) = standings([summary(), summary(values=without)])
    assert standing.aggregates[IndicatorName.PASSAGE_TIME].count == 1
    assert standing.aggregates[LEVEL].count == 2


def test_official_and_simulated_runs_are_never_mixed_and_a_replay_never_counts() -> None:
    runs = [summary(source=source) for source in ("ros", "simulated", "simulated", "replay")]
    (official,) = standings(runs)
    assert official.completed == 1
    (practice,) = standings(runs, official=False)
    assert practice.completed == 2
    assert standings(runs[3:]) == standings(runs[3:], official=False) == ()


def test_a_damaged_result_never_counts() -> None:
    runs = [summary(problem="result.json is damaged"), summary(outcome=None, problem="damaged")]
    assert standings(runs) == ()


def test_a_run_without_a_result_makes_no_standing_of_its_own() -> None:
    unfinished = summary(outcome=None, source=None, values={})
    assert standings([unfinished]) == ()
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


def test_the_time_of_a_failed_run_makes_it_no_better() -> None:
    early, declared = (
        timed(time, hour=hour, outcome=Outcome.TIMEOUT)
        for time, hour in ((300.0, 1.0), (20.0, 2.0))
    )
    (standing,) = standings([declared, early], best=1)
    assert standing.aggregates[HANDLE].mean == pytest.approx(early.values[HANDLE])
    assert early.values[HANDLE] != declared.values[HANDLE]


def test_of_equal_runs_the_earlier_is_the_better() -> None:
    first = summary(values={TIME: 10.0, HANDLE: 7.0, LEVEL: 6}, hour=1.0)
    second = timed(10.0, hour=2.0)
    (standing,) = standings([second, first], best=1)
    assert standing.aggregates[HANDLE].mean == 7.0


def test_all_conditions_of_a_team_together_weigh_every_run_the_same() -> None:
    runs = [timed(10.0), timed(20.0), summary(3, 8, values={TIME: 60.0}), summary(4, 8)]
    first, second = overall(runs)
    assert (first.subject, first.conditions, first.completed, first.counted) == (3, (7, 8), 3, 3)
    assert first.aggregates[TIME].mean == pytest.approx(30.0)
    assert (second.subject, second.conditions) == (4, (8,))


def test_the_best_of_all_conditions_are_the_best_of_each() -> None:
    runs = [timed(10.0), timed(20.0), summary(3, 8, values={TIME: 60.0, LEVEL: 1})]
    (team,) = overall(runs, best=1)
    assert (team.completed, team.counted) == (3, 2)
    assert team.aggregates[TIME].mean == pytest.approx(35.0)


def test_all_conditions_together_keep_rulesets_apart() -> None:
    runs = [summary(), summary(ruleset="eurobench-2020"), summary(source="simulated")]
    assert [team.ruleset for team in overall(runs)] == ["eurobench-2020", "protocol"]


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
    counted = [run for run in runs if run.official and run.valid]
    with_all = {
        (s.subject, s.condition, s.ruleset): s.aggregates for s in standings(runs, best=best)
    }
    for standing in standings(counted, best=best):
        key = (standing.subject, standing.condition, standing.ruleset)
        assert with_all.pop(key) == standing.aggregates
    assert not any(with_all.values())


@given(st.lists(RUNS, max_size=12))
def test_every_official_run_is_counted_once(runs: list[RunSummary]) -> None:
    counts = [s.completed + s.timeout + s.aborted for s in standings(runs)]
    ended = (Outcome.COMPLETED, Outcome.TIMEOUT, Outcome.ABORTED)
    whole = [run for run in runs if run.official and run.problem is None and run.outcome in ended]
    assert sum(counts) == len(whole)
    together = [team.completed + team.timeout + team.aborted for team in overall(runs)]
    assert sum(together) == len(whole)
