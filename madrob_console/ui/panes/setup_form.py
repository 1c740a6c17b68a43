"""The fields of a run's set-up."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import TypeVar

from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical
from textual.widget import Widget

from madrob_console.errors import MadrobError
from madrob_console.names import clean_name
from madrob_console.referee.questions import Ask
from madrob_console.referee.run_setup import RunSetup
from madrob_console.referee.teams import NO_TEAMS, TeamList
from madrob_console.ui.cells.choice import Choice
from madrob_console.ui.cells.field import Field, NumberField
from madrob_console.ui.cells.label import Label
from madrob_console.ui.cells.lines import Line, Lines, Span, Tone, line
from madrob_console.ui.defaults import FIRST_CONDITION, ConsoleDefaults
from madrob_console.ui.keys.asks import OtherName, ask_other_name
from madrob_console.ui.look.words import shortened
from madrob_console.ui.panes.team_line import TeamLine
from madrob_console.ui.panes.top_view import TopView
from scoring.protocol import BenchmarkType, Condition, LockDetection, Side, StartPose
from scoring.rulesets import RulesetName

E_ = TypeVar("E_", bound=StrEnum)
_OWN_POSE = "numbers below"

_WHO = ("Subject", "Team", "Referee", "Opening side", "Starting side", "Benchmark", "Condition")
_HOW = ("Run is", "Start pose", "x, y, yaw", "Timeout", "Countdown", "Ruleset", "Lock by")
_LISTED = "Team (/ list)"


class FieldNames(Lines):
    """The names of the fields beside them, one a row.

    A widget for each would be a third of all on the screen, and each costs whoever presses F2.
    """

    def __init__(self, names: Sequence[str]) -> None:
        super().__init__()
        self._names = tuple(names)

    def say(self, names: Sequence[str]) -> None:
        """Other names."""
        self._names = tuple(names)
        self.redraw()

    def lines(self, width: int) -> Sequence[Line]:
        """The names, however narrow it is."""
        return [line(Span(name, Tone.DIM)) for name in self._names]


class SetupForm(Horizontal):
    """Fields and a view of the start pose; reads and writes `RunSetup`s, knows no rule."""

    def __init__(self, defaults: ConsoleDefaults) -> None:
        super().__init__(id="setup-form")
        self._poses = {preset.name: preset.pose for preset in defaults.poses}
        condition = FIRST_CONDITION
        self.subject = NumberField(id="subject")
        self.team = Field(id="team")
        self.listed = TeamLine(id="listed-team")
        self._names = FieldNames(_WHO)
        self._teams = NO_TEAMS
        self._other: OtherName | None = None
        self.use_list(NO_TEAMS)
        self.run_number = NumberField(id="run-number")
        self.referee = Field(id="referee")
        self.practice = Choice(
            [("official", False), ("PRACTICE", True)], value=False, id="practice"
        )
        self.opening = _choice(Side, condition.opening_side, "opening", str.upper)
        self.starting = _choice(Side, condition.starting_side, "starting", str.upper)
        self.benchmark = _choice(BenchmarkType, condition.benchmark_type, "benchmark")
        self.condition_label = Label("")
        self.preset = Choice([(name, name) for name in (_OWN_POSE, *self._poses)], "", id="preset")
        self.x, self.y, self.yaw = (
            NumberField(id=name) for name in ("pose-x", "pose-y", "pose-yaw")
        )
        self.timeout = NumberField(id="timeout")
        self.countdown = NumberField(id="countdown")
        self.ruleset = _choice(RulesetName, defaults.run.ruleset, "ruleset")
        self.lock_detection = _choice(LockDetection, defaults.run.lock_detection, "lock")
        self.top_view = TopView()

    def compose(self) -> ComposeResult:
        """Who and in which condition, the rest, the pose seen from above."""
        yield Horizontal(
            self._names,
            Vertical(
                _row(self.subject, "  run ", self.run_number),
                self.team,
                self.listed,
                self.referee,
                self.opening,
                self.starting,
                self.benchmark,
                self.condition_label,
            ),
            classes="who",
        )
        yield Horizontal(
            FieldNames(_HOW),
            Vertical(
                self.practice,
                self.preset,
                _row(self.x, self.y, self.yaw),
                _row(self.timeout, " s"),
                _row(self.countdown, " s"),
                self.ruleset,
                self.lock_detection,
            ),
            classes="how",
        )
        yield self.top_view

    @property
    def condition(self) -> Condition:
        """The condition chosen."""
        return Condition(self.benchmark.value, self.opening.value, self.starting.value)

    def load(self, setup: RunSetup) -> None:
        """Show a set-up."""
        condition = setup.condition
        self.subject.value = str(setup.subject)
        self.team.value = setup.team
        self._other = None
        if setup.team_reason:
            self.take_name(OtherName(setup.subject, setup.team, setup.team_reason))
        self.run_number.value = str(setup.run_number)
        self.referee.value = setup.referee
        self.practice.value = setup.practice
        self.opening.value = condition.opening_side
        self.starting.value = condition.starting_side
        self.benchmark.value = condition.benchmark_type
        self.timeout.value = f"{setup.timeout:g}"
        self.countdown.value = f"{setup.countdown:g}"
        self.ruleset.value = setup.ruleset
        self.lock_detection.value = setup.lock_detection
        self.show_pose(setup.start_pose)

    def use_list(self, teams: TeamList) -> None:
        """Take the team's name from a list; without one it is typed."""
        self._teams = teams
        there = bool(teams.names)
        self._names.say([_LISTED if there and name == "Team" else name for name in _WHO])
        if there and self.team.has_focus:  # before it goes: or any other field would get it
            self.screen.set_focus(self.listed)
        self.team.display, self.listed.display = not there, there
        if self._other is not None:
            self.take_name(self._other)
        self.show_team()

    def take_name(self, other: OtherName) -> None:
        """Another name than the list's; one that is the list's takes an earlier one back."""
        differs = self._teams.differs(other.subject, other.name)
        self._other = other if differs else None
        self.show_team()

    def forget_name(self) -> None:
        """The list's name counts again."""
        self._other = None
        self.show_team()

    def show_team(self) -> None:
        """The name of the subject that is typed."""
        other = self._named_otherwise()
        name = self._teams.names.get(self.team_number, "") if other is None else other.name
        self.listed.say(name, other=other is not None)

    @property
    def team_number(self) -> int:
        """The subject that is typed; 0 = none."""
        text = self.subject.value.strip()
        return int(text) if text.isascii() and text.isdigit() and len(text) < 10 else 0

    def _named_otherwise(self) -> OtherName | None:
        """The other name of the subject that is typed."""
        other = self._other
        return other if other is not None and other.subject == self.team_number else None

    def ask_name(self, name: str) -> Ask[OtherName | str]:
        """What is asked for another name than the list's; it may have been typed already."""
        subject = self.team_number
        return ask_other_name(subject, self._teams.names.get(subject, ""), name)

    def show_names(self, setup: RunSetup) -> None:
        """Show the names as they were cleaned, so that nothing changes unseen."""
        for field, name in ((self.team, setup.team), (self.referee, setup.referee)):
            if field.value != name and not field.has_focus:  # who types goes on typing
                field.value = name

    def show_pose(self, pose: StartPose) -> None:
        """Write a pose into its fields."""
        for field, value in ((self.x, pose.x), (self.y, pose.y), (self.yaw, pose.yaw)):
            field.value = f"{value:g}"
        self.show_derived()

    def show_derived(self) -> None:
        """What follows from the fields: the condition in words, the preset that they match."""
        self.show_team()
        condition = self.condition
        way = condition.way.replace("from ", "")
        self.condition_label.say(f"{condition.number}: {way}")
        pose = self.pose()
        self.top_view.show_setup(condition, pose if isinstance(pose, StartPose) else None)
        names = (name for name, preset in self._poses.items() if preset == pose)
        self.preset.value = next(names, _OWN_POSE)

    def pose(self) -> StartPose | str:
        """The pose in the fields, or what is wrong with it."""
        try:
            return StartPose(
                _number(self.x, "start pose x", "metres"),
                _number(self.y, "start pose y", "metres"),
                _number(self.yaw, "start pose yaw", "degrees"),
            )
        except MadrobError as error:
            return str(error)

    def take_condition(self, condition: Condition) -> None:
        """Choose a condition; the start pose follows its side."""
        self.opening.value = condition.opening_side
        self.starting.value = condition.starting_side
        self.benchmark.value = condition.benchmark_type
        self.follow_side()
        self.show_derived()

    def take_preset(self) -> None:
        """The chosen preset's numbers."""
        if (pose := self._poses.get(self.preset.value)) is not None:
            self.show_pose(pose)

    def follow_side(self) -> None:
        """A preset pose changes over with the starting side; typed numbers stay."""
        pose, side = self.pose(), self.starting.value
        if pose not in self._poses.values() or (isinstance(pose, StartPose) and pose.side is side):
            return
        other = next((p for p in self._poses.values() if p.side is side), None)
        if other is not None:
            self.show_pose(other)

    def read(self) -> RunSetup | str:
        """The set-up in the fields, or what is wrong with them, naming the field."""
        try:
            pose = self.pose()
            if isinstance(pose, str):
                return pose
            other = self._named_otherwise()
            listed = self._teams.names.get(self.team_number, "") if other is None else other.name
            typed = None if self._teams.names else clean_name(self.team.value, "team")
            setup = RunSetup(
                subject=_whole(self.subject, "subject"),
                team=listed if typed is None else typed,
                run_number=_whole(self.run_number, "run number"),
                condition=self.condition,
                start_pose=pose,
                referee=clean_name(self.referee.value, "referee"),
                timeout=_number(self.timeout, "timeout", "seconds"),
                countdown=_number(self.countdown, "countdown", "seconds"),
                ruleset=self.ruleset.value,
                lock_detection=self.lock_detection.value,
                practice=self.practice.value,
                team_reason="" if other is None else other.reason,
            )
        except MadrobError as error:
            return str(error)
        return setup.problem() or setup


def _choice(
    values: type[E_], value: E_, name: str, label: Callable[[str], str] = str
) -> Choice[E_]:
    return Choice([(label(v.value), v) for v in values], value, id=name)


def _row(*parts: Widget | str) -> Widget:
    """Short fields with words between them."""
    widgets: list[Widget] = []
    for part in parts:
        widget = Label(part) if isinstance(part, str) else part
        widget.add_class("unit" if isinstance(part, str) else "short")
        widgets.append(widget)
    return Horizontal(*widgets, classes="row")


def _whole(field: Field, name: str) -> int:
    text = field.value.strip()
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise MadrobError(f"{name} '{shortened(text, 20)}': use a whole number")
    return int(text)


def _number(field: Field, name: str, unit: str) -> float:
    text = field.value.strip()
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) < 1e9:
        raise MadrobError(f"{name} '{shortened(text, 20)}': use a number of {unit}, as 1.5")
    return value
