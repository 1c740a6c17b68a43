"""What is heard over ROS: a day at the testbed, other messages, cameras, and strangers."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from recorder import Bag
from scoring import Condition, evaluate
from tests.stories import hands
from tests.stories.hands import Hall, needs_ros
from tests.stories.terminal import wait_until

STORE = get_typestore(Stores.ROS2_JAZZY)


def heard_in(folder: Path) -> dict[str, list[Any]]:
    """Return the messages of a recording by topic."""
    heard = defaultdict(list)
    for message in Bag(folder).messages():
        heard[message.topic].append(message)
    return heard


# Seen red: the testbed was not told the state of the run.
@needs_ros
@pytest.mark.machine
def test_day_over_ros_gives_the_same_digits(hall: Hall) -> None:
    hands.write_plan(hall, ["1,1,1"])
    hall.open_testbed()
    console = hall.console(rehearsal=True, testbed="ros")
    console.open_run()
    console.wait_for("COMPLETED", "not final", timeout=60.0)

    console.sign()

    run = hall.run()
    stored = {"Alpha": hands.value_of(run, "execution_time")}
    assert (run.level(), hands.plan(hall)["left"]) == (6, 0)
    assert hands.standings_values(hall, "execution_time") == stored
    assert hands.site_values(hall, "execution_time") == stored
    assert hands.zip_values(hall, 1, "execution_time") == stored
    assert hands.check(hall).code == 0


# Seen red: 200 degrees were half a turn.
@needs_ros
def test_lab_messages_score_like_plain_ones(hall: Hall) -> None:
    hands.expect_lab(hall)
    hands.publish(hall, "lab door")

    code = hands.begin_run_over_ros(hall).wait(60.0)

    run = hall.run()
    stored = run.result()
    assert (code, run.level(), hands.place_of(hall, run)) == (0, 6, "official")

    def signal(topic: str, measured: Callable[[Any], object]) -> tuple[Any, Any]:
        messages: list[Any] = [STORE.deserialize_cdr(m.data, m.type) for m in heard[topic]]
        stamps = [one.header.stamp for one in messages]
        times = np.array([stamp.sec + stamp.nanosec * 1e-9 for stamp in stamps])
        return times, np.array([measured(one) for one in messages])

    heard = heard_in(run.folder)
    ends = ("cw_left", "cw_right", "ccw_left", "ccw_right")
    plain = evaluate(
        Condition.from_number(1),
        stored["start"],
        door=signal("/lab/joints", lambda one: math.radians(one.position[1])),
        handle=signal("/lab/load_cell", lambda one: one.wrench.force.z * 0.00980665),
        passage={e: signal(f"/lab/ranges/{e}", lambda one: one.ranges / 1000.0) for e in ends},
        handle_zero=stored["handle_zero"],
    )
    values = {str(name): one.value for name, one in plain.indicators.items()}
    assert values == pytest.approx(hands.values_of(run), rel=1e-6)
    assert [e.time for e in plain.events] == [e["time"] for e in stored["events"]]


# Seen red: a dead recorder was not started again.
@needs_ros
@pytest.mark.machine
def test_killed_camera_recorder_costs_the_run_nothing(hall: Hall) -> None:
    hands.expect_cameras(hall)
    hands.publish(hall, "slow door", "camera")
    program = hands.begin_run_over_ros(hall)
    run = hall.run()
    wait_until(run.has_begun, "the start of the run", timeout=60.0)

    hands.kill_camera_recorder(hall)

    assert (program.wait(60.0), run.level()) == (0, 6)
    heard = heard_in(run.folder)["/madrob/door/angle"]
    door: list[Any] = [STORE.deserialize_cdr(m.data, m.type) for m in heard]
    numbers = [int(one.header.frame_id) for one in door]
    assert numbers == [*range(numbers[0], numbers[0] + len(numbers))]
    assert hands.recover(hall).code == 0
    pictures = [*Bag(run.folder, evidence=True).messages()]
    assert {picture.topic for picture in pictures} == {"/camera/front/image/compressed"}
    assert pictures[-1].receive_ns > stored_ns(run.result()["stop"])
    assert hands.check(hall).code == 0


def stored_ns(time: float) -> int:
    return round(time * 1e9)


# Seen red: escape sequences in plain ASCII were shown as they are.
@needs_ros
@pytest.mark.machine
def test_strangers_cannot_hold_up_an_abort(hall: Hall) -> None:
    hands.expect_cameras(hall)
    hands.publish(hall, "open door")
    console = hall.console(testbed="ros")
    lines = hands.watch_lines(hall)
    console.make_ready()
    console.start()
    run = hall.run()
    run.wait_for_event()

    hands.publish(hall, "flood", "nan", "wrong type", "escapes")
    wait_until(lambda: hands.faults_of(run) >= 2, "faults of the testbed", timeout=30.0)
    console.abort()

    assert run.outcome() == "aborted"
    handle = wait_until(lambda: heard_in(run.folder)["/madrob/handle/force"], "a recording")
    assert len(handle) > 1000
    assert hands.title_of(console) != "owned"
    assert not any(lines.read_bytes().count(evil) for evil in (b"\x1b]0", b"\x1b[2J", b"\x07"))
