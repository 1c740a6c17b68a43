"""The fields of a run's set-up, the team's among them, and what is said of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, StrEnum, auto
from typing import TYPE_CHECKING, ClassVar, TypeVar

from rich.cells import cell_len
from textual import events
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.message import Message
from textual.widget import Widget

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import clean_name, terminal_safe
from madrob_console.pages.competition import task_words
from madrob_console.referee.acts import Start
from madrob_console.referee.acts.act import Ask
from madrob_console.referee.competition_plan import PlanProgress, Task
from madrob_console.referee.lists import NO_TEAMS, TeamList
from madrob_console.referee.records import RunSetup
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.dialog import Field, NumberField
from madrob_console.ui.cells.lines import Choice, Label, Line, Lines, Span, Tone, line
from madrob_console.ui.keys.dialogs import OtherName, ask_other_name
from madrob_console.ui.link import FIRST_CONDITION, ConsoleDefaults
from madrob_console.ui.look.words import fitted, shortened
from madrob_console.ui.panes.top_view import TopView
from scoring.protocol import BenchmarkType, Condition, LockDetection, Side, StartPose
from scoring.rulesets import RulesetName

if TYPE_CHECKING:
    from madrob_console.engine.snapshot import Snapshot

# What the set-up pane says of its fields: errors, and the key that goes on.


OPEN = (Phase.IDLE, Phase.READY)
"""In these phases the fields are set up; in others they are a draft of the next run."""


class Focus(Enum):
    """Where keys go."""

    FIELD = auto()
    TEAM = auto()
    BUTTON = auto()
    ELSEWHERE = auto()


@dataclass(frozen=True, slots=True)
class SetupWords:
    """Words about a set-up; `setup` is what the fields say, or what is wrong with them."""

    snapshot: Snapshot
    setup: RunSetup | str
    plan: PlanProgress
    focus: Focus

    def state(self, problem: str) -> tuple[str, Tone]:
        """What becomes of it; `problem` comes first, besides what is wrong with the fields."""
        snapshot, setup, run = self.snapshot, self.setup, self.snapshot.run
        if snapshot.playback is not None:
            return "A replay: nothing is set up here. F3 shows the run.", Tone.WARN
        if snapshot.pulse.gone:
            return f"x {snapshot.pulse.gone}", Tone.BAD
        if snapshot.right.only_watches:
            return "This screen only watches. F3 shows the run.", Tone.PLAIN
        if run.active:
            return f"Not editable now: {run.phase}. F3 shows the run.", Tone.WARN
        if problem or isinstance(setup, str):
            return f"x {problem or setup}", Tone.BAD
        checked = setup == run.setup and run.phase in OPEN  # the check `team` says the rest
        team = self._team(setup, snapshot.teams, checked=checked)
        planned = self._planned(setup, checked=checked)
        what = f"un {setup.run_number} of subject {setup.subject}{planned}"
        if run.phase not in OPEN:
            return f"Draft of r{what}: {self._next_key}.{team}", Tone.PLAIN
        if not checked:
            told = f"Not set up yet{planned}: Enter, here or in a field."
            return told + team, Tone.WARN
        then = "F5 starts." if snapshot.refusal(Start.name) is None else "See the checks."
        if not run.pose_confirmed:
            then = "F6 confirms its pose."
        return f"R{what} is set up. {then}{team}", Tone.GOOD

    @property
    def next(self) -> str:
        """That x sets this up, if it is the plan's next run; else empty."""
        following, setup = self.plan.next, self.setup
        if following is None or isinstance(setup, str) or setup.practice:
            return ""
        if task_of(setup) != following.task:
            return ""
        task = task_words(following.task, self.snapshot.teams.names)
        attempt = f"attempt {following.number} of {following.planned}"
        return f"x: {task}, {attempt}. X repeats, p shows the plan."

    @property
    def _next_key(self) -> str:
        if self.focus in (Focus.FIELD, Focus.TEAM):
            return "Escape, then x sets it up"
        return "x or Enter sets it up" if self.focus is Focus.BUTTON else "x sets it up"

    def _team(self, setup: RunSetup, teams: TeamList, *, checked: bool) -> str:
        here = self.focus is Focus.TEAM
        if setup.team_reason:
            clears = " Del takes the list's." if here else ""
            return f" Other name than the list's: {setup.team_reason}.{clears}"
        if teams.lacks(setup.subject) and (setup.practice or not checked):
            return f" Subject {setup.subject} is not in the list of teams!"
        return " Type to look for a team." if here else ""

    def _planned(self, setup: RunSetup, *, checked: bool) -> str:
        if setup.out_of_plan:
            return "" if checked else ", OUT OF PLAN"
        of = next((one for one in self.plan.tasks if one.task == task_of(setup)), None)
        if setup.practice or of is None or not of.planned:
            return ""
        if not of.left:
            return ", an attempt repeated"
        return f", attempt {of.done + 1} of {of.planned}"


def task_of(setup: RunSetup) -> Task:
    return Task(setup.subject, setup.condition.number)


# The team of a set-up, chosen from a list of teams.


class TeamLine(Lines, can_focus=True):
    """The team's name. What is typed here looks for a team in the list."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("delete,backspace", "clear", show=False),
    ]

    class Typed(Message):
        """The referee looks for a team."""

        def __init__(self, text: str) -> None:
            super().__init__()
            self.text = text

    class Cleared(Message):
        """The list's name shall stand here again."""

    _team = ""
    _other = False

    def say(self, name: str, *, other: bool) -> None:
        """Shows a name, empty if the team is not in the list; `other`: it is not the list's."""
        self._team, self._other = name, other
        self.redraw()

    def lines(self, width: int) -> Sequence[Line]:
        mark = " OTHER" if self._other else ""
        name, room = self._team or "(not in the list)", max(1, width - len(mark))
        tone = Tone.PLAIN if self._team and not self._other else Tone.WARN
        return [
            line(
                Span(
                    name if cell_len(name) <= room else fitted(name, room),
                    Tone.CURSOR if self.has_focus else tone,
                ),
                Span(mark, Tone.WARN),
            )
        ]

    def check_consume_key(self, key: str, character: str | None) -> bool:
        """No letter that is typed here is a key of the console."""
        return character is not None and character.isprintable()

    def on_key(self, event: events.Key) -> None:
        if event.is_printable and event.character:
            event.stop()
            event.prevent_default()
            self.post_message(self.Typed(event.character))

    def on_paste(self, event: events.Paste) -> None:
        event.stop()
        self.post_message(self.Typed(terminal_safe(event.text.strip())))

    def on_click(self, _event: events.Click) -> None:
        self.post_message(self.Typed(""))

    def action_clear(self) -> None:
        self.post_message(self.Cleared())


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
        self._names = tuple(names)
        self.redraw()

    def lines(self, width: int) -> Sequence[Line]:
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
        return Condition(self.benchmark.value, self.opening.value, self.starting.value)

    def load(self, setup: RunSetup) -> None:
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
        """Another name than the list's; the list's own takes an earlier one back."""
        differs = self._teams.differs(other.subject, other.name)
        self._other = other if differs else None
        self.show_team()

    def forget_name(self) -> None:
        self._other = None
        self.show_team()

    def show_team(self) -> None:
        other = self._named_otherwise()
        name = self._teams.names.get(self.team_number, "") if other is None else other.name
        self.listed.say(name, other=other is not None)

    @property
    def team_number(self) -> int:
        """The subject that is typed; 0 = none."""
        text = self.subject.value.strip()
        return int(text) if text.isascii() and text.isdigit() and len(text) < 10 else 0

    def _named_otherwise(self) -> OtherName | None:
        other = self._other
        return other if other is not None and other.subject == self.team_number else None

    def ask_name(self, name: str) -> Ask[OtherName | str]:
        subject = self.team_number
        return ask_other_name(subject, self._teams.names.get(subject, ""), name)

    def show_names(self, setup: RunSetup) -> None:
        """Shows the names as they were cleaned, so that nothing changes unseen."""
        for field, name in ((self.team, setup.team), (self.referee, setup.referee)):
            if field.value != name and not field.has_focus:  # who types goes on typing
                field.value = name

    def show_pose(self, pose: StartPose) -> None:
        for field, value in ((self.x, pose.x), (self.y, pose.y), (self.yaw, pose.yaw)):
            field.value = f"{value:g}"
        self.show_derived()

    def show_derived(self) -> None:
        self.show_team()
        condition = self.condition
        way = condition.way.replace("from ", "")
        self.condition_label.say(f"{condition.number}: {way}")
        pose = self.pose()
        self.top_view.show_setup(condition, pose if isinstance(pose, StartPose) else None)
        names = (name for name, preset in self._poses.items() if preset == pose)
        self.preset.value = next(names, _OWN_POSE)

    def pose(self) -> StartPose | str:
        try:
            return StartPose(
                _number(self.x, "start pose x", "metres"),
                _number(self.y, "start pose y", "metres"),
                _number(self.yaw, "start pose yaw", "degrees"),
            )
        except MadrobError as error:
            return str(error)

    def take_condition(self, condition: Condition) -> None:
        """Chooses a condition; the start pose follows its side."""
        self.opening.value = condition.opening_side
        self.starting.value = condition.starting_side
        self.benchmark.value = condition.benchmark_type
        self.follow_side()
        self.show_derived()

    def take_preset(self) -> None:
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
