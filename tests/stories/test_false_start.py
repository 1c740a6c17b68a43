"""Somebody touches the handle during the countdown, and the referee decides."""

from __future__ import annotations

from tests.stories.hands import Console, Hall, needs_ros

pytestmark = needs_ros


def held_countdown(hall: Hall) -> Console:
    """A console on whose countdown somebody has touched the handle."""
    hall.set(run={"countdown": 4.0})
    hall.open_testbed()
    console = hall.console(testbed="ros")
    console.make_ready()
    console.start()
    hall.touch_handle()
    console.wait_for("FALSE START")
    return console


# Seen red: a restart leaves the countdown held.
def test_false_start_begins_the_countdown_again(hall: Hall) -> None:
    console = held_countdown(hall)
    console.restart_countdown()
    console.wait_for_run()
    assert hall.run().countdowns() == 2


# Seen red: an accepted false start leaves the countdown held.
def test_accepted_false_start_lets_countdown_go_on(hall: Hall) -> None:
    console = held_countdown(hall)
    console.accept_false_start()
    console.wait_for_run()
    assert hall.run().countdowns() == 1


# Seen red: F8 is refused before the start.
def test_false_start_can_be_aborted(hall: Hall) -> None:
    console = held_countdown(hall)
    console.abort()
    assert hall.run().outcome() == "aborted"
    assert not hall.run().has_begun()
