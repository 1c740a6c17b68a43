"""A replay beside the testbed: the run of the testbed stays in the hands of the referee."""

from __future__ import annotations

from tests.stories.hands import Hall, make_run


# Seen red: F8 on a replay means the replay, and is refused.
def test_f8_over_a_replay_aborts_the_run(hall: Hall) -> None:
    make_run(hall, rehearsal=False)
    acting = hall.console(speed=1.0)
    acting.make_ready()
    watching = hall.console(speed=1.0)
    watching.wait_for("has the right to act")
    watching.open_history("1 run")
    watching.open_replay()
    acting.start()
    watching.wait_for("GOES ON")
    watching.abort()
    acting.wait_for("ABORTED")
    assert hall.runs()[-1].outcome() == "aborted"


# Seen red: a replay outlives its terminal.
def test_replay_ends_with_its_terminal(hall: Hall) -> None:
    make_run(hall, rehearsal=False)
    console = hall.console(speed=1.0)
    console.make_ready()
    console.open_history("1 run")
    console.open_replay()
    assert console.hang_up() == 129
