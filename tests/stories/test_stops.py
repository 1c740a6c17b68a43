"""How a run ends: by the referee from everywhere, from a second console, by its timeout."""

from __future__ import annotations

from tests.stories.hands import Hall


# Seen red: F8 does nothing.
def test_f8_y_ends_a_run(hall: Hall) -> None:
    console = hall.console(speed=1.0)
    console.open_run()
    console.wait_for_run()
    console.abort()
    console.wait_for("ABORTED")
    assert hall.run().outcome() == "aborted"


# Seen red: F8 is ignored while a question is open.
def test_f8_y_ends_a_run_over_a_question(hall: Hall) -> None:
    console = hall.console(speed=1.0)
    console.open_run()
    console.wait_for_run()
    console.question_by_mouse()
    console.abort()
    assert hall.run().outcome() == "aborted"


# Seen red: F8 is ignored while the history is shown.
def test_f8_y_ends_a_run_over_a_list(hall: Hall) -> None:
    console = hall.console(speed=1.0)
    console.open_run()
    console.wait_for_run()
    console.open_history("1 run")
    console.abort()
    assert hall.run().outcome() == "aborted"


# Seen red: F8 y takes over the right to act, and does not abort.
def test_second_console_takes_over_and_aborts(hall: Hall) -> None:
    first = hall.console(speed=1.0)
    first.open_run()
    second = hall.console(speed=1.0)
    second.wait_for_run()
    second.abort()
    second.wait_for("ABORTED")
    first.wait_for("ABORTED", "has the right to act")
    assert hall.run().outcome() == "aborted"


# Seen red: the timeout does not stop a run.
def test_timeout_ends_a_run_that_counts(hall: Hall) -> None:
    hall.set(run={"countdown": 1.0, "timeout": 5.0})
    console = hall.console(rehearsal=True)
    console.open_run()
    console.wait_for_stop("TIMEOUT")
    assert hall.run().outcome() == "timeout"
    assert hall.run().level() == 3
    assert "Alpha 3" in hall.standings()
