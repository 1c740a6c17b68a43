"""No test runs outside of the rings, and none needs more than its ring gives."""

from __future__ import annotations

import subprocess
import sys
import time
from multiprocessing import get_context
from pathlib import Path

import pytest

from tests import rings
from tests.rings import NeedsMachineError, Ring


@pytest.mark.parametrize(
    ("place", "marks", "ring"),
    [
        ("scoring/calibration/test_masks.py", (), Ring.PURE),
        ("madrob_console/ui/test_keys.py", (), Ring.SCREENS),
        ("madrob_console/ui/test_keys.py", (Ring.MACHINE,), Ring.MACHINE),
        ("madrob_console/testbeds/test_recorded_bag.py", (), Ring.PURE),
        ("madrob_console/testbeds/ros/test_ros_source.py", (), Ring.MACHINE),
    ],
)
def test_a_tests_own_mark_counts_then_its_folder(
    request: pytest.FixtureRequest, place: str, marks: tuple[Ring, ...], ring: Ring
) -> None:
    assert rings.ring_of(an_item(request, place, *marks)) is ring


@pytest.mark.parametrize(
    ("place", "marks", "told"),
    [
        ("elsewhere/test_it.py", (), "in no ring; add its folder to tests/rings.py"),
        ("test_it.py", (), "in no ring; add its folder to tests/rings.py"),
        ("scoring/test_events.py", (Ring.PURE, Ring.MACHINE), "in the rings machine, pure; use"),
    ],
)
def test_a_test_in_no_ring_or_in_two_is_refused(
    request: pytest.FixtureRequest, place: str, marks: tuple[Ring, ...], told: str
) -> None:
    with pytest.raises(pytest.UsageError, match=told):
        rings.ring_of(an_item(request, place, *marks))


def an_item(request: pytest.FixtureRequest, place: str, *marks: Ring) -> pytest.Item:
    path = Path(__file__).parent / place
    parent = pytest.Dir.from_parent(request.session, path=path.parent)
    item = pytest.Function.from_parent(
        pytest.Module.from_parent(parent, path=path), name="test_it", callobj=lambda: None
    )
    for mark in marks:
        item.add_marker(mark.value)
    return item


def test_every_place_of_the_table_is_there() -> None:
    assert [place for place in rings.FOLDERS if not (Path(__file__).parent / place).exists()] == []


def test_outside_of_the_machine_nothing_sleeps_and_no_process_is_started() -> None:
    with pytest.raises(NeedsMachineError, match=r"^time.sleep: watch for it, use virtual time, or"):
        time.sleep(0.0)
    with pytest.raises(NeedsMachineError, match=r"^subprocess.Popen: "):
        subprocess.run([sys.executable, "-c", "pass"], check=True)
    with pytest.raises(NeedsMachineError, match=r"^the process "):
        get_context("spawn").Process(target=print).start()
