"""The checks before a start on values: what each finds, what blocks, what may be waived."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from madrob_console.referee.checks import (
    Check,
    CheckState,
    Readings,
    blocking,
    causes,
    preflight,
)
from madrob_console.referee.competition_plan import Plan
from madrob_console.referee.records import CheckName, Waiver
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.team_list import TeamList
from scoring.rest import FEWEST_SAMPLES, HandleRest
from tests.madrob_console.referee.test_acts import SETUP

REST = HandleRest(50, 5.9, 0.05, 0.2, 0.0, 1.0)
WELL = Readings(
    topic_faults=(),
    angle=0.0,
    closed_angle=0.03,
    near_zero=0.005,
    force=0.1,
    rest_force=0.5,
    zero=REST,
    drift=None,
    occupied=(),
    skew=0.01,
    largest_skew=0.1,
    disk_free=2_000_000_000,
    disk_needed=1_000_000_000,
    recorder_problem="",
    other_referee=None,
    least_skew=0.001,
    usual=SETUP,
)
READY = Run(Phase.READY, SETUP, pose_confirmed=True, handle_zero=5.9)
OFFICIAL = replace(SETUP, practice=False)
OK, WARNING, FAILED, NO_DATA, WAIVED = CheckState
Found = tuple[CheckState, str]
"""State and reason: what to do first."""


def found(name: CheckName, run: Run = READY, **changes: object) -> Found | None:
    readings = replace(WELL, **changes)  # type: ignore[arg-type]
    checks = {check.name: check for check in preflight(readings, run)}
    return (checks[name].state, checks[name].reason) if name in checks else None


def state(name: CheckName, run: Run, **changes: object) -> CheckState:
    verdict = found(name, run, **changes)
    assert verdict is not None
    return verdict[0]


N = CheckName
AGAIN = "zero the handle again: "


@pytest.mark.parametrize(
    ("name", "changes", "verdict"),
    [
        (N.TOPICS, {}, (OK, "all live and at their rates")),
        (N.TOPICS, {"topic_faults": ("a: silent",)}, (FAILED, "a: silent")),
        (N.TOPICS, {"topic_faults": ("a", "b", "c")}, (FAILED, "a (and 2 more)")),
        (N.DOOR, {}, (OK, "angle +0.000 rad, closed below 0.03")),
        (N.DOOR, {"angle": -0.005}, (OK, "angle -0.005 rad, closed below 0.03")),
        (N.DOOR, {"angle": 0.03}, (FAILED, "close the door: angle +0.030 rad, closed below 0.03")),
        (N.DOOR, {"angle": -0.5}, (FAILED, "close the door: angle -0.500 rad, closed below 0.03")),
        (N.DOOR, {"angle": 0.006}, (WARNING, "the closed door reads +6.0 mrad instead of 0")),
        (
            N.DOOR,
            {"angle": -0.029},
            (FAILED, "set the encoder's zero: the closed door reads -29.0 mrad instead of 0"),
        ),
        (
            N.DOOR,
            {"angle": None},
            (NO_DATA, "look whether its driver runs: no door angle comes now"),
        ),
        (N.HANDLE, {}, (OK, "+0.10 N from zero, at rest up to 0.50 N")),
        (N.HANDLE, {"force": -0.5}, (OK, "-0.50 N from zero, at rest up to 0.50 N")),
        (
            N.HANDLE,
            {"force": -0.51},
            (
                FAILED,
                "zero the handle, if nobody holds it: -0.51 N from zero, at rest up to 0.50 N",
            ),
        ),
        (
            N.HANDLE,
            {"force": None},
            (NO_DATA, "look whether its driver runs: no handle force comes now"),
        ),
        (N.HANDLE_ZERO, {}, None),
        (N.HANDLE_ZERO, {"zero": None}, None),
        (
            N.HANDLE_ZERO,
            {"drift": -1.3},
            (FAILED, f"{AGAIN}it was -1.30 N off after the last run"),
        ),
        (
            N.HANDLE_ZERO,
            {"zero": replace(REST, number=FEWEST_SAMPLES - 1)},
            (FAILED, f"{AGAIN}{FEWEST_SAMPLES - 1} samples, {FEWEST_SAMPLES} needed"),
        ),
        (N.HANDLE_ZERO, {"zero": replace(REST, number=FEWEST_SAMPLES, span=0.5)}, None),
        (
            N.HANDLE_ZERO,
            {"zero": replace(REST, span=0.6)},
            (FAILED, f"{AGAIN}samples span 0.60 N, steady up to 0.50 N"),
        ),
        (N.DOORWAY, {}, (OK, "sensors clear")),
        (
            N.DOORWAY,
            {"occupied": ("cw 0", "ccw 2")},
            (FAILED, "clear the doorway: something under cw 0, ccw 2"),
        ),
        (
            N.DOORWAY,
            {"occupied": None},
            (
                NO_DATA,
                (
                    "look whether its driver runs, or set its `no_echo`: "
                    "no reading of some passage sensor comes now"
                ),
            ),
        ),
        (
            N.DOORWAY,
            {"occupied": None, "unread_range": "passage cw left: range 3 is NaN"},
            (
                NO_DATA,
                (
                    "correct what its driver sends, or set its `no_echo`: "
                    "passage cw left: range 3 is NaN"
                ),
            ),
        ),
        (N.CLOCK, {"skew": -0.05}, (OK, "stamps differ by 50 ms, limit 100 ms")),
        (
            N.CLOCK,
            {"skew": 0.1},
            (FAILED, "set the clocks: stamps differ by 100 ms, limit 100 ms"),
        ),
        (
            N.CLOCK,
            {"skew": None},
            (NO_DATA, "look whether its driver runs: no time stamp comes now"),
        ),
        (N.CLOCK, {"least_skew": 10.0, "skew": 0.0}, (OK, "stamps differ by 0 ms, limit 100 ms")),
        (N.CLOCK, {"least_skew": -10.1}, (FAILED, "set the clock: stamps are of another clock")),
        (N.DISK, {}, (OK, "2.0 GB free, 1.0 GB needed")),
        (N.DISK, {"disk_free": 1_000_000_000}, (OK, "1.0 GB free, 1.0 GB needed")),
        (
            N.DISK,
            {"disk_free": 900_000_000},
            (FAILED, "make room on the disk: 900 MB free, 1.0 GB needed"),
        ),
        (
            N.DISK,
            {"disk_free": None},
            (NO_DATA, "look at the results folder: free space unknown"),
        ),
        (N.RECORDER, {}, (OK, "ready to open a file")),
        (N.RECORDER, {"recorder_problem": "read-only"}, (FAILED, "read-only")),
        (
            N.RECORDER,
            {"recorder_problem": None},
            (NO_DATA, "look at the results folder: the disk does not answer"),
        ),
        (N.REFEREE, {}, (OK, "none: only this engine tells the testbed")),
        (N.REFEREE, {"other_referee": "node b"}, (FAILED, "node b")),
        (N.POSE, {}, (OK, "confirmed")),
        (N.SETTINGS, {}, None),
        (N.SETTINGS, {"usual": None}, None),
        (N.TEAM, {"teams": TeamList({SETUP.subject: "Delft"})}, None),
        (
            N.TEAM,
            {"teams": TeamList({9: "Graz"})},
            (FAILED, "correct the team, or waive the check: 3 is not in the list"),
        ),
    ],
)
def test_a_check_says_what_it_finds_and_begins_with_what_to_do(
    name: CheckName, changes: dict[str, Any], verdict: Found | None
) -> None:
    assert found(name, **changes) == verdict


BAD = Plan((), ("plan.csv line 3: subject 'x' is no number from 1 to 999: write one",), "plan.csv")


@pytest.mark.parametrize(
    ("name", "run", "verdict"),
    [
        (N.POSE, replace(READY, pose_confirmed=False), (FAILED, "confirm the start pose")),
        (
            N.TEAM,
            replace(READY, setup=replace(SETUP, out_of_plan=True)),
            (FAILED, "correct the team, or waive the check: this run is out of plan"),
        ),
        (N.TEAM, replace(READY, setup=replace(SETUP, out_of_plan=True, practice=True)), None),
        (N.TEAM, Run(), None),
        (
            N.SETTINGS,
            replace(READY, setup=replace(SETUP, timeout=200.0)),
            (WARNING, "timeout 200 s, the settings say 300 s: change it in the set-up"),
        ),
        (N.SETTINGS, Run(), None),
        (N.POSE, replace(READY, phase=Phase.FINAL), (FAILED, "confirm the start pose")),
    ],
)
def test_what_is_set_up_is_checked_for_an_official_run_and_after_it_for_the_next(
    name: CheckName, run: Run, verdict: Found | None
) -> None:
    assert found(name, run) == verdict


def test_a_handle_that_was_never_zeroed_is_to_be_zeroed() -> None:
    never = replace(READY, handle_zero=0.0)
    words = "zero the handle: not yet done since the engine started"
    assert found(N.HANDLE, never, force=5.9) == (FAILED, words)
    assert found(N.HANDLE, never, force=0.4) == (OK, "+0.40 N from zero, at rest up to 0.50 N")


def test_a_waiver_lets_its_check_pass_for_that_run_alone() -> None:
    waived = replace(READY, waivers=(Waiver(N.DOOR, "warped", "Ada", 1.0),))
    words = "waived, warped (angle +0.500 rad, closed below 0.03)"
    assert found(N.DOOR, waived, angle=0.5) == (WAIVED, words)
    assert found(N.DOOR, waived) == (OK, "angle +0.000 rad, closed below 0.03")
    pose = replace(waived, waivers=(Waiver(N.POSE, "?", "Ada", 1.0),), pose_confirmed=False)
    assert found(N.POSE, pose) == (WAIVED, "waived, ?")
    over = replace(waived, phase=Phase.STOPPED)
    assert state(N.DOOR, over, angle=0.5) is FAILED
    clock = replace(READY, waivers=(Waiver(N.CLOCK, "?", "Ada", 1.0),))
    assert state(N.CLOCK, clock, least_skew=-50.0) is FAILED  # nothing is detected
    assert state(N.CLOCK, clock, skew=0.2) is WAIVED


def test_what_follows_from_a_silent_topic_is_no_cause_of_its_own() -> None:
    silent = replace(WELL, topic_faults=("all silent",), angle=None, force=None, occupied=None)
    checks = preflight(replace(silent, least_skew=-50.0, disk_free=None), READY)
    names = [N.CLOCK, N.TOPICS, N.DOOR, N.HANDLE, N.DOORWAY, N.DISK]
    assert [check.name for check in blocking(checks)] == names
    assert [check.name for check in causes(checks)] == [N.CLOCK, N.TOPICS, N.DISK]
    alone = preflight(replace(WELL, angle=None), READY)
    assert [check.name for check in causes(alone)] == [N.DOOR]
    assert blocking([Check(N.DOOR, each, "") for each in (OK, WARNING, WAIVED)]) == ()
