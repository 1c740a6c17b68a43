"""Days of a competition: what counts, what does not, and where it stands."""

from __future__ import annotations

import pytest

from tests.stories import hands
from tests.stories.hands import Hall
from tests.stories.terminal import wait_until


# Seen red: the means in the standings were rounded to four decimals.
def test_standings_site_and_zip_have_stored_digits(hall: Hall) -> None:
    hands.write_plan(hall, ["1,1,1", "2,1,2"])
    runs = [hands.make_run(hall, "nominal", subject=1), hands.make_run(hall, "slam", subject=2)]

    stored = {run.result()["team"]: hands.value_of(run, "execution_time") for run in runs}

    assert (hands.plan(hall)["done"], hands.plan(hall)["left"]) == (2, 1)
    assert [*stored] == ["Alpha", "Beta"]
    assert hands.standings_values(hall, "execution_time") == stored
    assert hands.site_values(hall, "execution_time") == stored
    assert hands.zip_values(hall, 1, "execution_time") == {"Alpha": stored["Alpha"]}
    assert hands.zip_values(hall, 2, "execution_time") == {"Beta": stored["Beta"]}


# Seen red: practice runs counted among the official ones.
def test_rehearsal_is_marked_and_practice_counts_nowhere(hall: Hall) -> None:
    rehearsed = hands.make_run(hall, "slam", subject=1)
    practised = hands.make_run(hall, "slam", subject=2, rehearsal=False)

    runs = (rehearsed, practised)
    assert [hands.place_of(hall, run) for run in runs] == ["rehearsal", "practice"]
    names = ["REHEARSAL Euro Door Cup", "Euro Door Cup"]
    assert [run.result()["competition"] for run in runs] == names
    assert "REHEARSAL" in hall.standings()
    assert [*hands.standings_values(hall, "execution_time")] == ["Alpha"]
    assert hands.standings_values(hall, "execution_time", rehearsal=False) == {}


# Seen red: a timeout ended with exit code 0.
@pytest.mark.parametrize(
    ("scenario", "timeout", "code", "outcome"),
    [("slam", 60.0, 0, "completed"), ("nominal", 3.0, 3, "timeout")],
)
def test_exit_code_says_how_a_run_ended(
    scenario: str, timeout: float, code: int, outcome: str, hall: Hall
) -> None:
    done = hands.simulate(hall, scenario, timeout=timeout)

    assert (done.code, hall.run().outcome()) == (code, outcome)


# Seen red: an aborted run ended with exit code 130.
def test_ctrl_c_aborts_a_run(hall: Hall) -> None:
    program = hands.begin_run(hall)
    run = hall.run()
    wait_until(run.has_begun, "the start of the run")

    code = hands.interrupt(program)

    assert (code, run.outcome()) == (4, "aborted")
    assert set(hands.values_of(run).values()) == {None}


@pytest.mark.parametrize("subject", [1000, 9])
def test_run_that_is_refused_leaves_nothing(subject: int, hall: Hall) -> None:
    done = hands.simulate(hall, "slam", *hands.NO_PATIENCE, subject=subject)

    assert (done.code, hall.runs()) == (2, [])
    assert done.errors.strip()
