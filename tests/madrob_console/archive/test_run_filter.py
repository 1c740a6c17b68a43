"""What a filter of the history finds."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.archive.history import RunSummary
from madrob_console.archive.run_filter import filter_problem, matches
from scoring.protocol import Outcome
from tests.madrob_console.run_folders import summary

FIELDS = "subject, sub, cond, run, team, outcome, closed, ruleset, testbed, competition"
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=60)
RUNS = st.builds(
    summary,
    subject=st.integers(1, 999),
    condition=st.integers(1, 20),
    team=TEXTS,
    outcome=st.sampled_from(Outcome),
    competition=TEXTS,
)
RUN = summary(3, 12, 2, team="TU Delft 門", final=True, team_word="protested", source="simulated")


@pytest.mark.parametrize(
    "text",
    [
        "", "  ", "delft", "DELFT tu", "門", "push", "from cw to ccw", "constant", "completed",
        "simulated", "protested", "autumn", "2023-11", "subject:3", "subject:003", "SUBJECT:3",
        "run:2", "cond:12", "sub:3", "outcome:completed", "team:delft", "team:門",
        "subject:3 run:2 delft", "subject:", "team:",
    ],
)  # fmt: skip
def test_a_filter_finds_a_run_by_its_words(text: str) -> None:
    assert matches(RUN, text)


@pytest.mark.parametrize(
    "text",
    [
        "ghent", "delft ghent", "pull", "timeout", "subject:2", "subject:33", "subject:x",
        "subject:0", "run:3", "run:12", "cond:1", "cond:2", "team:push", "team:simulated", "x:y",
    ],
)  # fmt: skip
def test_a_filter_leaves_other_runs_out(text: str) -> None:
    assert not matches(RUN, text)


def test_the_word_of_an_outcome_and_its_name_are_both_found() -> None:
    run = summary(outcome=Outcome.ABORTED)
    assert matches(run, "invalid")
    assert matches(run, "aborted")
    assert matches(summary(outcome=None), "unfinished")
    assert matches(summary(problem="result.json is damaged"), "damaged")


@pytest.mark.parametrize("text", ["foo:bar", "delft foo:", "FOO:bar", "ÉQUIPE:1"])
def test_a_field_that_no_run_has_is_named_with_those_that_there_are(text: str) -> None:
    name = "équipe" if "QU" in text else "foo"
    problem = f"no field {name}: there are {FIELDS}"
    assert filter_problem(text) == problem
    assert not matches(RUN, text)


@pytest.mark.parametrize("text", ["", "delft", "sub:3 outcome:completed", "14:28", "team:a:b", ":"])
def test_what_names_no_unknown_field_is_no_problem(text: str) -> None:
    assert filter_problem(text) is None


@given(RUNS, TEXTS, TEXTS)
def test_more_words_never_find_more(run: RunSummary, first: str, second: str) -> None:
    both = matches(run, f"{first} {second}")
    assert both == (matches(run, first) and matches(run, second))


@given(RUNS)
def test_every_run_is_found_by_its_own_team_and_numbers(run: RunSummary) -> None:
    numbers = f"subject:{run.subject} run:{run.run_number} cond:{run.condition}"
    assert matches(run, f"{run.team} {numbers}")
    assert not matches(run, f"subject:{run.subject + 1}")
