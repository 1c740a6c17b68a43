"""The pre-start checks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum

from madrob_console.common.formatting import format_size
from madrob_console.referee.competition_plan import NO_PLAN, Plan
from madrob_console.referee.records import CheckName, Waiver
from madrob_console.referee.run import Phase, Run
from madrob_console.referee.run_setup import RunSetup
from madrob_console.referee.team_list import NO_TEAMS, TeamList
from scoring.protocol import FARTHEST_ZERO
from scoring.rest import FEWEST_SAMPLES, HandleRest


class CheckState(StrEnum):
    """The result of a check. Missing data is a state of its own, never `ok`."""

    OK = "ok"
    WARNING = "warning"
    """Something to look at that stands in nobody's way."""
    FAILED = "failed"
    NO_DATA = "no data"
    WAIVED = "waived"


_ANOTHER_CLOCK = 10.0
"""s; larger offsets of stamps mean another clock (protocol section 3)."""

CORRECT_TEAM, OR_WAIVE = "correct the team", ", or waive the check"
CHANGE_SETUP = "change it in the set-up"

_NO_ZERO = "not yet done since the engine started"


@dataclass(frozen=True, slots=True)
class Check:
    """One pre-start check; it is not `waivable` where nothing would be detected.

    `finding` says what is so, `remedy` what to do; empty = nothing. The screens add the key.
    """

    name: CheckName
    state: CheckState
    finding: str
    waivable: bool = True
    remedy: str = ""

    @property
    def reason(self) -> str:
        """Begins with what to do, and stands alone."""
        return ": ".join(filter(None, (self.remedy, self.finding)))

    @property
    def blocks(self) -> bool:
        return self.state in (CheckState.FAILED, CheckState.NO_DATA)


@dataclass(frozen=True, slots=True)
class Readings:
    """What the checks look at, in rad, N, s and bytes; None = no data now.

    Attributes:
        topic_faults: one line per topic that is missing, stale or off its rate.
        near_zero: a closed door that reads more is not at its zero.
        force: handle force minus handle zero.
        rest_force: abs(force) above this is not at rest.
        zero: the samples behind the handle zero; None = it was never set.
        drift: offset of the handle at rest after the last run from this zero; None = small.
        skew: largest stamp - log time of the last second, with its sign.
        recorder_problem: why no run can be recorded; empty = one can; None = the disk has not
            answered.
        unread_range: why a passage sensor has no reading; None = it is not known.
        least_skew: the smallest of the last second on the topic where that is largest.
        usual: the set-up of the run with the values of the settings; None = no run is set up.
    """

    topic_faults: tuple[str, ...]
    angle: float | None
    closed_angle: float
    near_zero: float
    force: float | None
    rest_force: float
    zero: HandleRest | None
    drift: float | None
    occupied: tuple[str, ...] | None
    skew: float | None
    largest_skew: float
    disk_free: int | None
    disk_needed: int
    recorder_problem: str | None
    other_referee: str | None
    unread_range: str | None = None
    least_skew: float | None = None
    teams: TeamList = NO_TEAMS
    plan: Plan = NO_PLAN
    usual: RunSetup | None = None


def preflight(readings: Readings, run: Run) -> tuple[Check, ...]:
    """All checks in order, with the waivers of `run` applied; after a run those of the next.

    Screens are small: team and handle zero are listed only where they fail.
    """
    if run.phase in (Phase.STOPPED, Phase.FINAL):
        run = Run()  # what was seen and let pass was for that run alone
    checks = (
        *_team(readings, run.setup),
        *_plan(readings.plan, run.setup),
        *_settings(readings.usual, run.setup),
        _topics(readings),
        _door(readings),
        _handle(readings, run),
        *_zero(readings),
        _doorway(readings),
        _clock(readings),
        _disk(readings),
        _recorder(readings),
        _referee(readings),
        _pose(run),
    )
    return tuple(_waive(check, run.waivers) for check in checks)


def blocking(checks: Iterable[Check]) -> tuple[Check, ...]:
    """The checks that block a start; first those that cannot be waived."""
    return tuple(sorted((check for check in checks if check.blocks), key=lambda c: c.waivable))


_OF_TOPICS = (CheckName.DOOR, CheckName.HANDLE, CheckName.DOORWAY, CheckName.CLOCK)


def causes(checks: Iterable[Check]) -> tuple[Check, ...]:
    """The checks that block a start, but for those that lack the data of a topic named above."""
    blocks = blocking(checks)
    named = any(check.name is CheckName.TOPICS for check in blocks)
    return tuple(
        check
        for check in blocks
        if not (named and check.name in _OF_TOPICS and check.state is CheckState.NO_DATA)
    )


def _waive(check: Check, waivers: tuple[Waiver, ...]) -> Check:
    if not check.blocks or not check.waivable:
        return check
    waiver = next((w for w in waivers if w.check is check.name), None)
    if waiver is None:
        return check
    finding = f" ({check.finding})" if check.finding else ""
    return Check(check.name, CheckState.WAIVED, f"waived, {waiver.reason}{finding}")


def _verdict(name: CheckName, ok: bool, finding: str, remedy: str) -> Check:
    if ok:
        return Check(name, CheckState.OK, finding)
    return Check(name, CheckState.FAILED, finding, remedy=remedy)


def _no_data(name: CheckName, what: str) -> Check:
    words = f"no {what} comes now"
    return Check(name, CheckState.NO_DATA, words, remedy="look whether its driver runs")


def _team(r: Readings, setup: RunSetup | None) -> Iterator[Check]:
    """Why this team cannot have an official run now (protocol section 2)."""
    if setup is None or setup.practice:
        return
    if r.teams.lacks(setup.subject):
        text = f"{setup.subject} is not in the list"
    elif setup.out_of_plan:
        text = "this run is out of plan"
    else:
        return
    remedy = f"{CORRECT_TEAM}{OR_WAIVE}"
    yield Check(CheckName.TEAM, CheckState.FAILED, text, remedy=remedy)


def _plan(plan: Plan, setup: RunSetup | None) -> Iterator[Check]:
    """A line that cannot be used, where this may be its team."""
    words = "" if setup is None or setup.practice else plan.unusable_line(setup.subject)
    if words:
        remedy = f"correct the plan{OR_WAIVE}"
        yield Check(CheckName.PLAN, CheckState.FAILED, words, remedy=remedy)


def _settings(usual: RunSetup | None, setup: RunSetup | None) -> Iterator[Check]:
    if setup is not None and usual is not None and setup != usual:
        words = f"{'; '.join(setup.differences(usual))}: {CHANGE_SETUP}"
        yield Check(CheckName.SETTINGS, CheckState.WARNING, words)


def _topics(r: Readings) -> Check:
    more = len(r.topic_faults) - 1
    first = "".join(r.topic_faults[:1]) + (f" (and {more} more)" if more > 0 else "")
    return _verdict(CheckName.TOPICS, not first, first or "all live and at their rates", "")


def _door(r: Readings) -> Check:
    if r.angle is None:
        return _no_data(CheckName.DOOR, "door angle")
    if r.near_zero < abs(r.angle) < r.closed_angle:
        text = f"the closed door reads {1000 * r.angle:+.1f} mrad instead of 0"
        if abs(r.angle) <= FARTHEST_ZERO:
            return Check(CheckName.DOOR, CheckState.WARNING, text)
        return _verdict(CheckName.DOOR, False, text, "set the encoder's zero")
    text = f"angle {r.angle:+.3f} rad, closed below {r.closed_angle:g}"
    closed = abs(r.angle) < r.closed_angle
    return _verdict(CheckName.DOOR, closed, text, "close the door")


def _handle(r: Readings, run: Run) -> Check:
    if r.force is None:
        return _no_data(CheckName.HANDLE, "handle force")
    text = f"{r.force:+.2f} N from zero, at rest up to {r.rest_force:.2f} N"
    rests = abs(r.force) <= r.rest_force
    if not (rests or run.handle_zero):
        return _verdict(CheckName.HANDLE, False, _NO_ZERO, "zero the handle")
    return _verdict(CheckName.HANDLE, rests, text, "zero the handle, if nobody holds it")


def _zero(r: Readings) -> Iterator[Check]:
    """Why the handle zero is not reliable (protocol section 11)."""
    zero = r.zero
    if r.drift is not None:
        text = f"it was {r.drift:+.2f} N off after the last run"
    elif zero is not None and zero.number < FEWEST_SAMPLES:
        text = f"{zero.number} samples, {FEWEST_SAMPLES} needed"
    elif zero is not None and zero.span > r.rest_force:
        text = f"samples span {zero.span:.2f} N, steady up to {r.rest_force:.2f} N"
    else:
        return
    remedy = "zero the handle again"
    yield Check(CheckName.HANDLE_ZERO, CheckState.FAILED, text, remedy=remedy)


def _doorway(r: Readings) -> Check:
    if r.occupied is None:
        words = "no reading of some passage sensor comes now"
        remedy = "look whether its driver runs, or set its `no_echo`"
        if r.unread_range is not None:
            words = r.unread_range
            remedy = "correct what its driver sends, or set its `no_echo`"
        return Check(CheckName.DOORWAY, CheckState.NO_DATA, words, remedy=remedy)
    finding = f"something under {', '.join(r.occupied)}" if r.occupied else "sensors clear"
    return _verdict(CheckName.DOORWAY, not r.occupied, finding, "clear the doorway")


def _clock(r: Readings) -> Check:
    if r.skew is None:
        return _no_data(CheckName.CLOCK, "time stamp")
    if (words := _another_clock(r)) is not None:
        return Check(CheckName.CLOCK, CheckState.FAILED, words, waivable=False)
    limit = f"limit {r.largest_skew * 1000:.0f} ms"
    text = f"stamps differ by {abs(r.skew) * 1000:.0f} ms, {limit}"
    same = abs(r.skew) < r.largest_skew
    return _verdict(CheckName.CLOCK, same, text, "set the clocks")


def _another_clock(r: Readings) -> str | None:
    if abs(r.least_skew or 0.0) <= _ANOTHER_CLOCK:
        return None
    return "set the clock: stamps are of another clock"


_LOOK = "look at the results folder"


def _disk(r: Readings) -> Check:
    if r.disk_free is None:
        return Check(CheckName.DISK, CheckState.NO_DATA, "free space unknown", remedy=_LOOK)
    text = f"{format_size(r.disk_free)} free, {format_size(r.disk_needed)} needed"
    enough = r.disk_free >= r.disk_needed
    return _verdict(CheckName.DISK, enough, text, "make room on the disk")


def _recorder(r: Readings) -> Check:
    if r.recorder_problem is None:
        silent = "the disk does not answer"
        return Check(CheckName.RECORDER, CheckState.NO_DATA, silent, remedy=_LOOK)
    problem = r.recorder_problem
    return _verdict(CheckName.RECORDER, not problem, problem or "ready to open a file", "")


def _referee(r: Readings) -> Check:
    alone = "none: only this engine tells the testbed"
    return _verdict(CheckName.REFEREE, r.other_referee is None, r.other_referee or alone, "")


def _pose(run: Run) -> Check:
    confirmed = "confirmed" if run.pose_confirmed else ""
    return _verdict(CheckName.POSE, run.pose_confirmed, confirmed, "confirm the start pose")
