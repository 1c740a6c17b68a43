"""The set-up pane: the fields of the next run and the pre-start checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

from msgspec.structs import asdict
from textual import events
from textual.actions import SkipAction
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.message import Message
from textual.widgets import Input

from madrob_console.common.errors import MadrobError
from madrob_console.config.tables import start_pose_on
from madrob_console.engine.requests import NextRunNumber, Perform
from madrob_console.referee.acts import SetUp
from madrob_console.referee.acts.act import Ask
from madrob_console.referee.checks import Check, CheckState
from madrob_console.referee.competition_plan import Task
from madrob_console.referee.records import CheckName, RunSetup
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.dialog import NumberField
from madrob_console.ui.cells.lines import (
    Choice,
    Label,
    Line,
    PushButton,
    Span,
    Target,
    Tone,
    View,
    line,
    paragraph,
    width_of,
)
from madrob_console.ui.keys.dialogs import OtherName
from madrob_console.ui.link import FIRST_CONDITION, NOT_YET, ConsoleDefaults, EngineLink
from madrob_console.ui.look.words import fitted, shortened, time_of_day
from madrob_console.ui.panes.setup_form import OPEN, Focus, SetupForm, SetupWords, TeamLine, task_of
from madrob_console.ui.panes.team_picker import TeamPicker
from scoring.protocol import Condition

if TYPE_CHECKING:
    from madrob_console.archive.history import RunSummary
    from madrob_console.engine.snapshot import Snapshot
    from madrob_console.ui.panes.plan_pane import PlanReader

# The pre-start checks with their reasons.


_MARKS = {
    CheckState.OK: ("✓", Tone.GOOD),
    CheckState.WARNING: ("!", Tone.WARN),
    CheckState.FAILED: ("x", Tone.BAD),
    CheckState.NO_DATA: ("?", Tone.BAD),
    CheckState.WAIVED: ("~", Tone.WARN),
}
_WAIVES = "w waives one (Escape leaves a field)"


class CheckList(View, can_focus=True):
    """One check a line; with the focus, up and down choose one and Enter waives it."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "move(-1)", show=False),
        Binding("down", "move(1)", show=False),
        Binding("enter", "choose", show=False),
    ]

    class Chosen(Message):
        """The referee wants to waive a check."""

        def __init__(self, check: CheckName) -> None:
            super().__init__()
            self.check = check

    class Left(Message):
        """Up on the first check."""

    _cursor = 0

    def draw_lines(self, snapshot: Snapshot, width: int) -> Sequence[Line]:
        if snapshot.playback is not None:
            return [line(Span("Checks  ", Tone.STRONG), "made on the day; F4 shows the waivers")]
        if snapshot.pulse.stale:
            head = line(Span("Checks  ", Tone.STRONG))
            lines = [line(*head, Span(f"old: of {time_of_day(snapshot.time)}", Tone.WARN))]
            return [*lines, *(_faded(check, width) for check in snapshot.checks)]
        over = snapshot.run.phase in (Phase.STOPPED, Phase.FINAL)
        watches = snapshot.right.only_watches
        how = "Enter waives the marked one" if self.has_focus else _WAIVES
        lines = [_header(snapshot.checks, "" if watches else how, over=over)]
        for number, check in enumerate(snapshot.checks):
            at_cursor = self.has_focus and number == self._cursor
            lines += _entry(check, width, str(number), at_cursor=at_cursor)
        if snapshot.sides_problem is not None:
            head = line(Span("  ! sides  ", Tone.WARN))  # no check: its words need the room
            lines += paragraph(snapshot.sides_problem, width, head=head)
        if snapshot.teams.problems and not watches:
            first, *more = snapshot.teams.problems
            rest = f" (and {len(more)} more: / shows them)" if more else ""
            head = line(Span("  ! teams  ", Tone.WARN))
            lines += paragraph(first + rest, width, head=head)
        return lines

    def action_move(self, step: int) -> None:
        """Chooses the next or previous check; above the first the focus goes back."""
        checks = () if self._snapshot is None else self._snapshot.checks
        if self._cursor + step < 0:
            self.post_message(self.Left())
            return
        self._cursor = min(max(0, len(checks) - 1), self._cursor + step)
        self.redraw()

    def on_click(self, event: events.Click) -> None:
        """Marks the check under the mouse; a double click waives it."""
        if (hit := self.clicked(event)) is not None:
            self._cursor = int(hit[0])
            self.redraw()
            if event.chain == 2:
                self.action_choose()

    def action_choose(self) -> None:
        checks = () if self._snapshot is None else self._snapshot.checks
        if self._cursor < len(checks):
            self.post_message(self.Chosen(checks[self._cursor].name))

    def on_focus(self) -> None:
        checks = () if self._snapshot is None else self._snapshot.checks
        self._cursor = next((i for i, check in enumerate(checks) if check.blocks), 0)
        self.redraw()


def _header(checks: Sequence[Check], how: str, *, over: bool) -> Line:
    """What stands in the way, and how it is waived; of a run that is `over` nothing can be."""
    blocking = sum(check.blocks for check in checks)
    verdict = (
        Span(f"{blocking} of {len(checks)} in the way of a start", Tone.BAD)
        if blocking
        else Span("all passed or waived", Tone.GOOD)
    )
    if over:
        return line(Span("Checks for the next run  ", Tone.STRONG), verdict)
    return line(
        Span("Checks  ", Tone.STRONG), verdict, Span(f"   {how}" if blocking else "", Tone.DIM)
    )


def _faded(check: Check, width: int) -> Line:
    return line(Span(shortened(f"  ? {check.name:<15} was {check.state}", width), Tone.DIM))


def _entry(check: Check, width: int, click: str, *, at_cursor: bool) -> list[Line]:
    mark, tone = _MARKS[check.state]
    head = line(
        Target("> " if at_cursor else "  ", Tone.STRONG, click),
        Target(f"{mark} ", tone, click),
        Target(f"{check.name:<15} ", Tone.CURSOR if at_cursor else Tone.PLAIN, click),
        Target(f"{check.state:<6} ", tone, click),
    )
    if check.state is CheckState.OK:
        return [(*head, Span(fitted(check.reason, max(10, width - width_of(head))), Tone.DIM))]
    return paragraph(check.reason, width, head=head)


_DRAFTED = (Phase.IDLE, Phase.STOPPED, Phase.FINAL)
_ASKING = "asking"
"""What waits for the engine; the latest replaces those before."""

NEVER_OFFICIAL = "a simulated testbed's runs are never official"


class SetupPane(Vertical):
    """Sets a run up when a field is left, so that no change waits unseen.

    After a run the fields are a draft for the next one, set up only when asked for.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "focus_step(-1)", show=False),
        Binding("down", "focus_step(1)", show=False),
        Binding("enter", "enter", show=False),
        Binding("slash", "search", show=False),
        # in a field, before its own: what is typed next goes into the next one, however fast
        Binding("up", "leave_field(-1)", show=False, priority=True),
        Binding("down", "leave_field(1)", show=False, priority=True),
        Binding("enter", "leave_field(1)", show=False, priority=True),
    ]

    class NextRun(Message):
        """The referee asks for the next run."""

    class Naming(Message):
        """The referee wants another name for the team than the list has."""

        def __init__(self, ask: Ask[OtherName | str]) -> None:
            super().__init__()
            self.ask = ask

    def __init__(self, link: EngineLink, defaults: ConsoleDefaults, plan: PlanReader) -> None:
        super().__init__(id="setup")
        self._plan = plan
        self._last: RunSetup | None = None
        self._link = link
        self._defaults = defaults
        self._free_names: dict[int, str] = {}
        self._snapshot: Snapshot | None = None
        self._proposed: tuple[int, int, bool] | None = None
        self._team_of: int | None = None
        self._on_its_way = False
        self._problem = ""
        self._no_number = ""
        self._letter = ""
        self._untouched: RunSetup | str = ""
        self._form = SetupForm(defaults)
        self._button = PushButton("Set up this run", id="set-up")
        self._state = Label(id="setup-state")
        self._checks = CheckList()
        self._picker = TeamPicker()

    def compose(self) -> ComposeResult:
        yield self._picker
        yield self._form
        yield Horizontal(self._button, self._state, id="setup-row")
        yield self._checks

    def enter(self) -> None:
        self._close_picker()
        self.screen.set_focus(self._form.subject)

    def rest(self) -> None:
        """Where letters are keys, Enter sets up and arrows go to the fields."""
        self._close_picker()
        self.screen.set_focus(self._button)

    def follow(self, snapshot: Snapshot) -> None:
        before, self._snapshot = self._snapshot, snapshot
        self.disabled = snapshot.run.active or snapshot.right.only_watches
        if before is None or snapshot.teams != before.teams:
            self._form.use_list(snapshot.teams)
            self._picker.show_teams(snapshot.teams)
        late = snapshot.simulated is not None and not self._form.practice.value
        if before is None:
            self._load(snapshot)
        elif late or (before.run.active and not snapshot.run.active):
            self._form.practice.value |= late
            if not late:
                self._untouched = self._form.read()
            self.propose_again()
        if snapshot.run.phase in (Phase.STOPPED, Phase.FINAL):
            self._last = snapshot.run.setup
        if self._plan.is_old(snapshot):
            self.run_worker(self._follow_plan(), group="plan", exclusive=True)

    def show(self, snapshot: Snapshot) -> None:
        self.follow(snapshot)
        run = snapshot.run
        self._button.say("Set up this run" if run.phase in OPEN else "Set up the next run")
        self._say_state()
        self._checks.show(snapshot)

    def commit(self) -> None:
        """Sets the run up as the fields say; the keys go on until the engine has answered."""
        self.run_worker(self._set_up(), group=_ASKING, exclusive=True)

    async def _set_up(self) -> str | None:
        setup = await self.draft()
        self._snapshot = self._link.snapshot()
        if self._snapshot is None:
            return NOT_YET
        run = self._snapshot.run
        if run.phase not in OPEN:
            return None  # a draft for the next run
        if isinstance(setup, str):
            return setup
        self._form.show_names(setup)
        self._untouched = self._form.read()
        problem = ""
        if setup != run.setup or self._on_its_way:
            self._on_its_way = True  # stays so where nobody waits for the answer any more
            try:
                refused = await self._link.answer(Perform.of(SetUp(setup)))
            except MadrobError as error:
                refused = str(error)
            problem = refused or ""
            self._on_its_way = False
        if self._read() == setup:  # else it is about what nobody wants any more
            self._problem = problem
        return problem or None

    async def commit_edits(self) -> str | None:
        """Before an act on a run that is set up: what has been typed since counts."""
        snapshot = self._link.snapshot()
        if snapshot is None or snapshot.run.phase not in OPEN:
            return None
        if snapshot.run.phase is Phase.READY or self.display:  # what is seen is meant
            self.workers.cancel_group(self, _ASKING)
            return await self._set_up()
        draft = await self.draft()
        return draft if isinstance(draft, str) else None

    def remember_referee(self, name: str) -> None:
        if not self._form.referee.value.strip():
            self._form.referee.value = name

    def take_name(self, other: OtherName) -> None:
        self._form.take_name(other)
        self.commit()

    def propose_like(self, run: RunSummary) -> None:
        """Proposes the team and the condition of an earlier run, with the next run number."""
        self._free_names.setdefault(run.subject, run.team)
        self.propose(Task(run.subject, run.condition))

    def propose(self, task: Task) -> None:
        """Proposes a team in a condition, with the next run number; the plan changes it no more."""
        self._form.subject.value = str(task.subject)
        self._form.take_condition(Condition.from_number(task.condition))
        self._proposed, self._untouched = None, ""

    def propose_same(self) -> None:
        """Proposes the team and the condition of the run that ended last."""
        if self._last is not None:
            self.propose(task_of(self._last))

    async def propose_planned(self) -> None:
        """Proposes what the plan has next, unless somebody has chosen anything else."""
        if self._snapshot is not None and self._snapshot.plan.lines:
            await self._plan.read()
            await self._take_planned()

    async def _follow_plan(self) -> None:
        await self._plan.read()
        now = self._snapshot
        if now is not None and now.playback is None and now.run.phase in _DRAFTED:
            await self._take_planned()

    async def _take_planned(self) -> None:
        following, now = self._plan.progress.next, self._snapshot
        if now is not None and now.run.setup is not None and self._form.practice.value:
            return  # who practises goes on with the same: that is not planned
        if following is not None and self._form.read() == self._untouched:
            self.propose(following.task)
            await self._propose()
            self._untouched = self._form.read()

    @property
    def next_words(self) -> str:
        """What x sets up, if that is the plan's next run; empty while that is not known."""
        now = self._snapshot
        if now is None or now.result is None or self._plan.behind:
            return ""
        return self._words(now).next if self._form.read() == self._untouched else ""

    async def draft(self) -> RunSetup | str:
        """The set-up in the fields with the next run number, or what is wrong with it."""
        if not self._plan.version and self._snapshot is not None and self._snapshot.plan.lines:
            await self._plan.read()
        await self._propose()
        setup = self._read()
        if isinstance(setup, RunSetup):
            self._free_names[setup.subject] = setup.team
        return setup

    def on_input_changed(self, _event: Input.Changed) -> None:
        self._problem = self._letter = ""
        self._form.show_derived()
        self._say_state()

    def on_input_blurred(self, _event: Input.Blurred) -> None:
        """A field that is left counts, if something was typed."""
        if self._form.read() != self._untouched:
            self.commit()

    def on_descendant_focus(self) -> None:
        self._letter = ""
        self._say_state()

    def on_choice_changed(self, event: Choice.Changed) -> None:
        practice = self._form.practice
        simulated = self._snapshot is not None and self._snapshot.simulated is not None
        if event.choice is practice and simulated and not practice.value:
            practice.value, self._problem = True, NEVER_OFFICIAL
            return
        if event.choice is self._form.preset:
            self._form.take_preset()
        elif event.choice is self._form.starting:
            self._form.follow_side()
        self._form.show_derived()
        self.commit()

    def on_number_field_refused(self, event: NumberField.Refused) -> None:
        """Says it below the fields; a slash asks for the list, from there, too."""
        event.stop()
        if event.letter == "/":
            self.action_search()
            return
        what = f"{event.field}: '{event.letter}' is no number"
        self._letter = f"{what}. Escape, then letters are keys."
        self._say_state()

    def on_team_line_typed(self, event: TeamLine.Typed) -> None:
        if self.has_class("-picking"):
            self._picker.type(event.text)
        else:
            self.action_search()
            self._picker.type(event.text.lstrip(" /"))

    def on_team_line_cleared(self, _event: TeamLine.Cleared) -> None:
        self._form.forget_name()
        self.commit()

    def action_search(self) -> None:
        self.add_class("-picking")
        self._picker.open(self._form.team_number)

    def on_team_picker_named(self, event: TeamPicker.Named) -> None:
        self.rest()
        self.post_message(self.Naming(self._form.ask_name(event.name)))

    def on_team_picker_picked(self, event: TeamPicker.Picked) -> None:
        self.rest()
        if event.subject is not None:
            self._form.subject.value = str(event.subject)
            self.commit()

    def _close_picker(self) -> None:
        self.remove_class("-picking")

    def on_push_button_pressed(self, _event: PushButton.Pressed) -> None:
        if self._snapshot is not None and self._snapshot.run.phase in OPEN:
            self.commit()
        else:
            self.post_message(self.NextRun())

    def on_check_list_left(self, _event: CheckList.Left) -> None:
        self.action_focus_step(-1)

    def action_enter(self) -> None:
        self.commit()
        self.action_focus_step(1)

    def action_leave_field(self, step: int) -> None:
        """Goes to another field; what the old one says counts. SkipAction if none has the focus."""
        if not isinstance(self.screen.focused, Input) or self.has_class("-picking"):
            raise SkipAction
        self.commit()
        self.action_focus_step(step)

    def action_focus_step(self, step: int) -> None:
        (self.screen.focus_next if step > 0 else self.screen.focus_previous)()

    def _read(self) -> RunSetup | str:
        setup = self._form.read()
        if isinstance(setup, str):
            return setup
        task, run = task_of(setup), None if self._snapshot is None else self._snapshot.run
        out = not setup.practice and self._plan.progress.out_of_plan(task)
        if run is not None and run.phase is Phase.READY and run.setup is not None:
            # when the plan changes what is set up stays within it, or comes into it
            out &= run.setup.out_of_plan or task_of(run.setup) != task
        return replace(setup, out_of_plan=out)

    def _load(self, snapshot: Snapshot) -> None:
        setup = snapshot.run.setup
        shown = setup or self._first_setup()
        self._form.load(shown)
        self._form.practice.value |= snapshot.simulated is not None
        self._untouched, self._team_of = self._form.read(), shown.subject
        if setup is not None:
            self._free_names[setup.subject] = setup.team
            self._proposed = (setup.subject, setup.condition.number, setup.practice)
        if setup is None or not (snapshot.run.active or snapshot.run.phase in OPEN):
            self.propose_again()

    def _first_setup(self) -> RunSetup:
        known = self._defaults
        return RunSetup(
            subject=1,
            team=known.team,
            run_number=1,
            condition=FIRST_CONDITION,
            start_pose=start_pose_on(FIRST_CONDITION.starting_side, known.poses),
            referee=known.referee,
            **asdict(known.run),
        )

    def propose_again(self, *, only_later: bool = False) -> None:
        """Proposes the next run number again; `only_later` keeps a chosen one unless it is used."""

        async def propose() -> None:
            untouched = self._form.read() == self._untouched
            await self._propose(only_later=only_later)
            if untouched:
                self._untouched = self._form.read()

        self._proposed = None
        self.run_worker(propose(), group=_ASKING, exclusive=True)

    @property
    def _wanted(self) -> tuple[int, int, bool] | None:
        """Subject, condition, whether practice; None if the subject is no number."""
        text = self._form.subject.value.strip()
        good = text.isascii() and text.isdigit()
        form = self._form
        return (int(text), form.condition.number, form.practice.value) if good else None

    async def _propose(self, *, only_later: bool = False) -> None:
        wanted, form = self._wanted, self._form
        if wanted is None or wanted == self._proposed:
            return
        if wanted[0] != self._team_of:
            self._team_of, form.team.value = wanted[0], self._free_names.get(wanted[0], "")
            form.forget_name()
        typed = form.run_number.value
        problem, proposed = "", typed
        try:
            number = await self._link.answer(NextRunNumber(*wanted))
            used = not typed.isdecimal() or int(typed) < number
            proposed = str(number) if used or not only_later else typed
        except MadrobError as error:
            problem = str(error)
        if wanted == self._wanted:  # else another one is asked for
            # what was not answered is asked again, with the next key that needs it
            self._proposed, self._no_number = None if problem else wanted, problem
            if form.run_number.value == typed:
                form.run_number.value = proposed

    def _say_state(self) -> None:
        if self._snapshot is not None:
            words = self._words(self._snapshot)
            told = self._problem or self._no_number
            wrong = words.setup if isinstance(words.setup, str) else told
            self._state.say(*words.state(self._letter or wrong))

    def _words(self, snapshot: Snapshot) -> SetupWords:
        focused = self.screen.focused
        focus = Focus.FIELD if isinstance(focused, Input) else Focus.ELSEWHERE
        if focused is self._form.listed:
            focus = Focus.TEAM
        elif focused is self._button:
            focus = Focus.BUTTON
        return SetupWords(snapshot, self._read(), self._plan.progress, focus)
