"""The fields of a run's set-up."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from enum import StrEnum
from typing import Any, ClassVar, TypeAlias, TypeVar

from msgspec import structs
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.widgets import Input, Static

from madrob_console.archive.folders import holds_rehearsals
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import REHEARSAL, clean_name
from madrob_console.config.tables import start_pose_on
from madrob_console.referee.competition_plan import Task
from madrob_console.referee.run_setup import RunSetup
from madrob_console.referee.team_list import NO_TEAMS, TeamList
from madrob_console.ui.cells.controls import Choice, Label, PushButton
from madrob_console.ui.cells.field import Field, NumberField
from madrob_console.ui.cells.lines import Line, Span, Tone, line
from madrob_console.ui.keys.questions import OtherName
from madrob_console.ui.link import FIRST_CONDITION, ConsoleDefaults
from madrob_console.ui.look.words import shortened
from madrob_console.ui.panes.top_view import TopView
from scoring.indicator_table import RulesetName
from scoring.protocol import BenchmarkType, Condition, LockDetection, Side, StartPose


class FoldLine(PushButton):
    """One line for the fields that seldom change; pressing it shows or hides them."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("right", "press", show=False)]

    def lines(self, width: int) -> Sequence[Line]:
        return [line(Span(self.label, Tone.CURSOR if self.has_focus else Tone.PLAIN))]


E_ = TypeVar("E_", bound=StrEnum)
Entry: TypeAlias = Field | Choice[Any]

# The names beside the fields; a widget for each would be a third of all on the screen.
_WHO = (
    *("Subject", "Team (/ list)", "Run", "Run is"),
    *("Opening side", "Starting side", "Benchmark", "Condition"),
)
_HOW = (
    *("Start pose", "x, m", "y, m", "Yaw, deg"),
    *("Timeout, s", "Countdown, s", "Ruleset", "Lock by", "Referee"),
)
_CONDITION = ("benchmark_type", "opening_side", "starting_side")
_POSE = ("x", "y", "yaw")
_NEXT = "run-number"
"""Without a number the field means the next one."""
_OWN_POSE = "x, y, yaw"


class SetupForm(Horizontal):
    """Fields and a view of the start pose; reads and writes `RunSetup`s, knows no rule.

    Attributes:
        fields: by the names that their values have in a set-up, its condition and its start pose.
        free_names: teams' names that were typed, by subject.
        teams: the list of teams.
        other: a name that differs from the one in the list.
    """

    def __init__(self, defaults: ConsoleDefaults) -> None:
        self._defaults = defaults
        self._presets = {preset.name: preset.pose for preset in defaults.poses}
        self.subject = NumberField(id="subject")
        self.team = Field(id="team")
        self.run_number = NumberField(id=_NEXT)
        counting = REHEARSAL if holds_rehearsals(defaults.results) else "official"
        self.practice = Choice([(counting, False), ("PRACTICE", True)], False, id="practice")
        self.starting = _choice(Side, "starting", str.upper)
        self.preset = Choice(
            [(name, name) for name in (_OWN_POSE, *self._presets)], "", id="preset"
        )
        self.referee = Field(id="referee")
        self._who: dict[str, Entry] = {
            "subject": self.subject,
            "team": self.team,
            "run_number": self.run_number,
            "practice": self.practice,
            "opening_side": _choice(Side, "opening", str.upper),
            "starting_side": self.starting,
            "benchmark_type": _choice(BenchmarkType, "benchmark"),
        }
        self._how: dict[str, Entry] = {
            **{name: NumberField(id=f"pose-{name}") for name in _POSE},
            "timeout": NumberField(id="timeout"),
            "countdown": NumberField(id="countdown"),
            "ruleset": _choice(RulesetName, "ruleset"),
            "lock_detection": _choice(LockDetection, "lock"),
            "referee": self.referee,
        }
        self.fields = self._who | self._how
        self.free_names: dict[int, str] = {}
        self.other: OtherName | None = None
        self.teams = NO_TEAMS
        self._team_of = 0
        self._condition_words = Label()
        self._top_view = TopView()
        who = Vertical(*self._who.values(), self._condition_words)
        how = Vertical(self.preset, *self._how.values())
        super().__init__(
            Horizontal(Static("\n".join(_WHO)), who, classes="who"),
            Horizontal(Static("\n".join(_HOW)), how, classes="how"),
            self._top_view,
            id="setup-form",
        )

    @property
    def condition(self) -> Condition:
        return Condition(*(_value_of(self.fields[name]) for name in _CONDITION))

    @property
    def pose(self) -> StartPose | None:
        """None while one of its numbers is none."""
        try:
            return StartPose(*(_value_of(self.fields[name]) for name in _POSE))
        except MadrobError:
            return None

    @property
    def team_number(self) -> int:
        """The subject that is typed; 0 = none."""
        text = self.subject.value.strip()
        return int(text) if text.isascii() and text.isdigit() and len(text) < 10 else 0

    @property
    def seldom_changed(self) -> str:
        """The values that are folded into one line."""
        said = {name: str(field.value).strip() for name, field in self._how.items()}
        chosen = self.preset.value
        pose = " ".join(said[name] for name in _POSE) if chosen == _OWN_POSE else chosen
        values = (
            *(f"pose {pose.replace(',', '')}", f"{said['timeout']} s"),
            *(f"countdown {said['countdown']} s", said["ruleset"]),
            *(f"lock by {said['lock_detection']}", said["referee"]),
        )
        return ", ".join(filter(None, values))

    def load(self, setup: RunSetup | None) -> None:
        """Shows a set-up; without one what is proposed for the first run."""
        defaults = self._defaults
        setup = setup or RunSetup(
            subject=1,
            team=defaults.team,
            run_number=1,
            condition=FIRST_CONDITION,
            start_pose=self._usual_pose(FIRST_CONDITION.starting_side),
            referee=defaults.referee,
            **structs.asdict(defaults.run),
        )
        self._team_of, self.other = setup.subject, None
        if setup.team_reason:
            self.other = OtherName(setup.subject, setup.team, setup.team_reason)
        values = asdict(setup)
        self.show_values(values | values["condition"] | values["start_pose"] | {"run_number": ""})

    def take_settings(self) -> None:
        """Timeout, countdown, ruleset, lock and pose are those of the settings again."""
        pose = self._usual_pose(self.starting.value)
        self.show_values(structs.asdict(self._defaults.run) | asdict(pose))

    def _usual_pose(self, side: Side) -> StartPose:
        return start_pose_on(side, self._defaults.poses)

    def show_values(self, values: Mapping[str, Any]) -> None:
        """Writes what has a field, and what follows from it; tells nobody of a change."""
        with self.prevent(Input.Changed):
            for name in values.keys() & self.fields.keys():
                field, value = self.fields[name], values[name]
                text = f"{value:g}" if isinstance(value, float) else str(value)
                field.value = value if isinstance(field, Choice) else text
            self.show_derived()

    def use_list(self, teams: TeamList) -> None:
        """With a list, the team's name is the list's and is not typed."""
        self.teams = teams
        if teams.names and self.team.has_focus:  # or what is typed next would go anywhere
            self.screen.set_focus(self.subject)
        self.team.disabled = bool(teams.names)
        self.team.placeholder = "(not in the list)" if teams.names else ""
        self.show_values({})

    def show_derived(self) -> None:
        """Shows what follows from the fields: the team's name, the condition, the start pose."""
        subject, condition, pose = self.team_number, self.condition, self.pose
        if subject != self._team_of:  # a name belongs to its subject
            self.free_names[self._team_of] = self.team.value
            self._team_of, self.other = subject, None
            self.team.value = self.free_names.get(subject, "")
        if self.other is not None and not self.teams.differs(subject, self.other.name):
            self.other = None  # the list has it now, too
        if self.teams.names:
            listed = self.teams.names.get(subject, "")
            self.team.value = listed if self.other is None else self.other.name
        way = condition.way.replace("from ", "")
        self._condition_words.say(f"{condition.number}: {way}", Tone.DIM)
        self._top_view.show_setup(condition, pose)
        presets = (name for name, preset in self._presets.items() if preset == pose)
        self.preset.value = next(presets, _OWN_POSE)

    def take_task(self, task: Task) -> None:
        """Chooses a team and a condition, the rest as in the settings."""
        condition = Condition.from_number(task.condition)
        self.show_values(asdict(condition) | {"subject": task.subject, "run_number": ""})
        self.take_settings()

    def take_preset(self) -> None:
        if (pose := self._presets.get(self.preset.value)) is not None:
            self.show_values(asdict(pose))

    def follow_side(self) -> None:
        """A preset pose changes over with the starting side; typed numbers stay."""
        pose, side = self.pose, self.starting.value
        if pose is not None and pose in self._presets.values() and pose.side is not side:
            on_side = (preset for preset in self._presets.values() if preset.side is side)
            self.show_values(asdict(next(on_side, pose)))

    def read(self) -> RunSetup | str:
        """The set-up in the fields, or what is wrong with them, naming the field.

        Run number 0 = none is typed.
        """
        try:
            values = {name: _value_of(field) for name, field in self.fields.items()}
        except MadrobError as error:
            return str(error)
        pose = StartPose(*(values.pop(name) for name in _POSE))
        condition = Condition(*(values.pop(name) for name in _CONDITION))
        reason = "" if self.other is None else self.other.reason
        setup = RunSetup(condition=condition, start_pose=pose, team_reason=reason, **values)
        return replace(setup, run_number=setup.run_number or 1).problem() or setup


def _choice(values: type[E_], name: str, label: Callable[[str], str] = str) -> Choice[E_]:
    first, *_ = values
    return Choice([(label(value.value), value) for value in values], first, id=name)


def _value_of(field: Entry) -> Any:  # noqa: ANN401 - each field has its own type
    """What a field says; MadrobError names it."""
    if isinstance(field, Choice):
        return field.value
    name, text = (field.id or "").replace("-", " "), field.value.strip()
    if not isinstance(field, NumberField):
        return clean_name(text, name)
    if field.id == _NEXT and not text:
        return 0
    whole = field.id in ("subject", _NEXT)
    try:
        value = int(text) if whole else float(text)
    except ValueError:
        value = math.nan
    if not abs(value) < 1e9:
        wanted = "a whole number" if whole else "a number, as 1.5"
        raise MadrobError(f"{name} '{shortened(text, 20)}': use {wanted}")
    return value
