"""The set-up pane: the fields of the next run and the pre-start checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

from textual import work
from textual.actions import SkipAction
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.message import Message
from textual.widgets import Input

from madrob_console.common.errors import MadrobError
from madrob_console.engine.requests import NextRunNumber
from madrob_console.engine.snapshot import Snapshot
from madrob_console.pages.plan_text import task_words
from madrob_console.referee.acts import SetUp, Start
from madrob_console.referee.competition_plan import PlanProgress, Task
from madrob_console.referee.run import Phase
from madrob_console.referee.run_setup import RunSetup
from madrob_console.referee.run_summary import RunSummary
from madrob_console.ui.cells.controls import Choice, Label, PushButton
from madrob_console.ui.cells.field import NumberField
from madrob_console.ui.cells.lines import Tone
from madrob_console.ui.keys.console_questions import ask_other_name
from madrob_console.ui.keys.key_table import CAPS
from madrob_console.ui.keys.questions import Ask, OtherName
from madrob_console.ui.link import NOT_YET, ConsoleDefaults, EngineLink
from madrob_console.ui.panes.check_list import CheckList
from madrob_console.ui.panes.plan_pane import PlanReader
from madrob_console.ui.panes.setup_form import FoldLine, SetupForm
from madrob_console.ui.panes.team_picker import TeamPicker

_NEXT = (Phase.IDLE, Phase.STOPPED, Phase.FINAL)
"""In these phases the next run is set up."""

_SET_UP = "set up"
"""What waits for the engine; the latest replaces those before."""


class SetupPane(Vertical):
    """The set-up of the current run, or after a run a draft of the next one; Enter sets it up.

    Pose and start commit the form first. `number_used` says that a start
    was refused, which may have used the run's number: a later one is taken then.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        # before a field's own: what is typed next goes into the next one, however fast
        Binding("up", "focus_step(-1)", show=False, priority=True),
        Binding("down", "focus_step(1)", show=False, priority=True),
        Binding("enter", "set_up", show=False),
        Binding("slash", "search", show=False),
    ]

    class NextRun(Message):
        """The referee asks for the next run."""

    @dataclass
    class Naming(Message):
        """The referee wants another name for the team than the list has."""

        ask: Ask

    def __init__(self, link: EngineLink, defaults: ConsoleDefaults, plan: PlanReader) -> None:
        self._form = SetupForm(defaults)
        self._fold = FoldLine("", id="fold")
        self._button = PushButton("Set up this run", id="set-up")
        self._state = Label(id="setup-state")
        self._checks = CheckList()
        self._picker = TeamPicker()
        row = Horizontal(self._button, self._state, id="setup-row")
        super().__init__(self._picker, self._form, self._fold, row, self._checks, id="setup")
        self._plan = plan
        self._link = link
        self._snapshot: Snapshot | None = None
        self._on_its_way = self._chosen = self.number_used = False
        self._problem = ""

    def enter(self) -> None:
        self.rest()
        self.screen.set_focus(self._form.subject)

    def rest(self) -> None:
        """Where letters are keys, Enter sets up and arrows go to the fields."""
        self.remove_class("-picking")
        self.screen.set_focus(self._button)

    def follow(self, snapshot: Snapshot) -> None:
        before, self._snapshot = self._snapshot, snapshot
        self.disabled = snapshot.run.active or snapshot.right.only_watches
        if before is None or snapshot.teams != before.teams:
            self._form.use_list(snapshot.teams)
        if before is None:
            self._form.load(snapshot.run.setup)
        elif snapshot.run.setup != before.run.setup:  # what was typed for it is no draft any more
            self._form.show_values({"run_number": ""})
            self._chosen = False
        if snapshot.run.phase in _NEXT and (before is None or before.run.phase not in _NEXT):
            self._form.take_settings()  # what was changed for one run is not for the next one
        self._form.practice.value |= snapshot.only_practice
        self._form.practice.disabled = snapshot.only_practice
        if self._plan.is_old(snapshot):
            self.run_worker(self.propose_planned(), group="plan", exclusive=True)

    def show(self, snapshot: Snapshot) -> None:
        self.follow(snapshot)
        self._button.say(f"Set up {'this' if self._is_open else 'the next'} run")
        self._say_state()
        self._checks.show(snapshot)

    @property
    def _is_open(self) -> bool:
        """Whether the fields are set up now; else they are a draft of the next run."""
        return self._snapshot is not None and self._snapshot.run.phase in OPEN

    @work(group=_SET_UP, exclusive=True)
    async def commit(self) -> None:
        """Sets the run up as the fields say; the keys go on until the engine has answered."""
        await self._set_up()

    async def _set_up(self) -> str | None:
        if words := self.finished_words:
            return words
        entered, setup = self._form.read(), await self.draft()
        now = self._link.snapshot()
        if now is None or now.run.phase not in OPEN:
            return None if now else NOT_YET
        problem = setup if isinstance(setup, str) else await self._change(now.run.setup, setup)
        if self._form.read() == entered:  # else it is about what nobody wants any more
            if isinstance(entered, RunSetup):  # the names as they were cleaned
                self._form.show_values({"team": entered.team, "referee": entered.referee})
            self._problem = problem
            self._say_state()
        return problem or None

    async def _change(self, before: RunSetup | None, setup: RunSetup) -> str:
        """Sets the run up unless it is like that; what the engine refuses, empty if nothing."""
        if setup == before and not self._on_its_way:
            return ""
        self._on_its_way = True  # stays so where nobody waits for the answer any more
        refused = await self._link.refusal_of(SetUp(setup))
        self._on_its_way = False
        return refused or ""

    async def commit_edits(self) -> str | None:
        """Before an act on a run that is set up: what has been typed since counts."""
        now = self._link.snapshot()
        meant = OPEN if self.display else (Phase.READY,)
        if now is None or now.run.phase not in meant:
            return None
        self.workers.cancel_group(self, _SET_UP)
        return await self._set_up()

    def remember_referee(self, name: str) -> None:
        if not self._form.referee.value.strip():
            self._form.show_values({"referee": name})

    def take_name(self, other: OtherName) -> None:
        self._form.other = other
        self._form.show_values({})
        self.commit()

    def propose_like(self, run: RunSummary) -> None:
        """Proposes the team and the condition of an earlier run, with the next run number."""
        self._form.free_names.setdefault(run.subject, run.team)
        self.propose(Task(run.subject, run.condition))

    def propose(self, task: Task) -> None:
        """Proposes a team in a condition, with the next run number; the plan changes it no more."""
        self._form.take_task(task)
        self._chosen = True

    def propose_official(self, task: Task) -> None:
        """Proposes an official run, unless the testbed is simulated: all is practice there."""
        self._form.practice.value = self._form.practice.disabled
        self.propose(task)

    def propose_same(self) -> None:
        """Proposes the team and the condition of the current run."""
        if self._snapshot is not None and self._snapshot.run.setup is not None:
            self.propose(task_of(self._snapshot.run.setup))

    async def propose_planned(self) -> None:
        """Proposes what the plan has next, unless somebody has chosen anything else."""
        now = self._snapshot
        if now is None or not (now.plan.lines or self._plan.progress.lines):
            return
        await self._plan.read()
        now, following = self._snapshot, self._plan.progress.next
        if now is None or self._chosen or now.playback is not None:
            return
        if self.finished_words and now.run.phase is Phase.IDLE:
            self._form.show_values({"subject": ""})
            self._say_state()
        if following is None:
            return
        over = now.run.phase in (Phase.STOPPED, Phase.FINAL) and not self._form.practice.value
        if over or now.run.phase is Phase.IDLE:  # who practises goes on with the same
            self.propose_official(following.task)
            self._chosen = False

    @property
    def finished_words(self) -> str:
        """Words that the plan is done, while nobody has chosen another run; else empty."""
        now, plan = self._snapshot, self._plan.progress
        if now is None or not plan.finished or self._chosen or self._form.practice.value:
            return ""
        if now.run.phase is Phase.READY or now.run.active:
            return ""
        return f"The plan is finished: {plan.planned} of {plan.planned}. s shows the standings."

    @property
    def attempt(self) -> str:
        """Which attempt of the plan the current run is; empty = none of the plan."""
        setup = None if self._snapshot is None else self._snapshot.run.setup
        if setup is None or setup.practice:
            return ""
        return self._plan.progress.attempt(task_of(setup))

    @property
    def next_words(self) -> str:
        """What x sets up, if that is the plan's next run; empty while that is not known."""
        now = self._snapshot
        if now is None or now.result is None or self._plan.behind or self._chosen:
            return ""
        return next_words(self._read(), self._plan.progress, now.teams.names)

    async def draft(self) -> RunSetup | str:
        """The set-up in the fields with the next run number, or what is wrong with it."""
        if not self._plan.version and self._snapshot is not None and self._snapshot.plan.lines:
            await self._plan.read()
        self._form.show_values({})  # a key that comes at once: a name belongs to its subject
        setup = self._read()
        if isinstance(setup, str) or (setup.run_number and not self.number_used):
            return setup
        wanted = NextRunNumber(setup.subject, setup.condition.number, setup.practice)
        try:
            number = await self._link.answer(wanted)
        except MadrobError as error:
            return str(error)
        self.number_used = False
        return replace(setup, run_number=max(number, setup.run_number))

    def on_input_changed(self, _event: Input.Changed) -> None:
        self._take_change()

    def on_choice_changed(self, event: Choice.Changed) -> None:
        form = self._form
        if event.choice is form.preset:
            form.take_preset()
        elif event.choice is form.starting:
            form.follow_side()
        self._take_change()

    def _take_change(self) -> None:
        self._problem, self._chosen = "", True
        self._form.show_derived()
        self._say_state()

    def on_descendant_focus(self) -> None:
        self._problem = ""
        self._say_state()

    def on_input_submitted(self, _event: Input.Submitted) -> None:
        self.action_set_up()

    def on_number_field_refused(self, event: NumberField.Refused) -> None:
        """Says it below the fields; a slash asks for the list, from there, too."""
        event.stop()
        if event.letter == "/":
            self.action_search()
            return
        what = f"{event.field}: '{event.letter}' is no number"
        self._problem = f"{what}. Escape, then letters are keys."
        self._say_state()

    def on_push_button_pressed(self, _event: PushButton.Pressed) -> None:
        if self._fold.has_focus:
            self.toggle_class("-unfolded")
            self._say_state()
        else:
            self.action_set_up()

    def on_team_picker_picked(self, event: TeamPicker.Picked) -> None:
        self.rest()
        if event.other is not None:
            subject, names = self._form.team_number, self._form.teams.names
            ask = ask_other_name(subject, names.get(subject, ""), event.other)
            self.post_message(self.Naming(ask))
        elif event.subject is not None:
            self._form.other = None
            self._form.show_values({"subject": event.subject})
            self.commit()

    def action_search(self) -> None:
        self.add_class("-picking")
        self._picker.open(self._form.teams, self._form.team_number)

    def action_set_up(self) -> None:
        if self._is_open:
            self.commit()
        else:
            self.post_message(self.NextRun())

    def action_focus_step(self, step: int) -> None:
        """Goes to another field; SkipAction where arrows move in a list."""
        if self.has_class("-picking") or self._checks.has_focus:
            raise SkipAction
        (self.screen.focus_next if step > 0 else self.screen.focus_previous)()

    def _read(self) -> RunSetup | str:
        """The set-up in the fields; run number 0 = the next one, which the engine knows."""
        setup, now = self._form.read(), self._snapshot
        if isinstance(setup, str) or now is None:
            return setup
        number, task = setup.run_number, task_of(setup)
        out = not setup.practice and self._plan.progress.out_of_plan(task)
        ready = now.run.setup if now.run.phase is Phase.READY else None
        if ready is not None and task_of(ready) == task:
            out &= ready.out_of_plan  # when the plan changes it stays within it, or comes into it
            if ready.practice is setup.practice:
                number = number or ready.run_number
        return replace(setup, run_number=number, out_of_plan=out)

    def _say_state(self) -> None:
        if (now := self._snapshot) is None:
            return
        if words := self.finished_words:
            self._state.say(words, Tone.GOOD)
            return
        setup = self._read()
        if isinstance(setup, str) and not isinstance(self.screen.focused, Input):
            self.add_class("-unfolded")  # what is wrong may be among the folded ones
        number = isinstance(setup, RunSetup) and setup.run_number
        self._form.run_number.placeholder = str(number or "next")
        sign = "- Less" if self.has_class("-unfolded") else "+ More"
        self._fold.say(f"{sign}: {self._form.seldom_changed}")
        self._state.say(*state_words(now, setup, self._plan.progress, self._problem))


OPEN = (Phase.IDLE, Phase.READY)
"""In these phases the fields are set up; in others they are a draft of the next run."""


def state_words(
    now: Snapshot, setup: RunSetup | str, plan: PlanProgress, problem: str
) -> tuple[str, Tone]:
    """A line under the fields: whether the set-up in them counts, or the errors in them."""
    run = now.run
    if (refused := now.refusal(SetUp.name)) is not None:
        what = "be set up here" if now.right.only_watches else "be set up now"
        return f"No run can {what}: {refused}.", Tone.WARN
    if problem or isinstance(setup, str):
        return f"x {problem or setup}", Tone.BAD
    why = setup.team_reason
    other = f" Other name than the list's: {why}." if why else ""
    checked = setup == run.setup and run.phase in OPEN
    planned = _planned(setup, plan, checked=checked)
    if run.phase not in OPEN:
        return f"Draft for subject {setup.subject}{planned}: Enter sets it up.{other}", Tone.PLAIN
    if not checked:
        return f"Not set up yet{planned}: Enter sets it up.{other}", Tone.WARN
    then = "F5 starts." if now.refusal(Start.name) is None else "See the checks."
    if not run.pose_confirmed:
        then = f"{CAPS['pose']} confirms its pose."
    what = f"Run {setup.run_number} of subject {setup.subject}{planned}"
    return f"{what} is set up. {then}{other}", Tone.GOOD


def _planned(setup: RunSetup, plan: PlanProgress, *, checked: bool) -> str:
    of = next((task for task in plan.tasks if task.task == task_of(setup)), None)
    if setup.out_of_plan:
        return "" if checked else ", OUT OF PLAN"
    if setup.practice or of is None or not of.planned:
        return ""
    return f", {plan.attempt(of.task)}" if of.left else ", an attempt repeated"


def next_words(setup: RunSetup | str, plan: PlanProgress, names: Mapping[int, str]) -> str:
    """What x sets up, if that is the plan's next run or one more of practice; else empty."""
    following = plan.next
    if following is None or isinstance(setup, str):
        return ""
    if setup.practice:
        return "x: practice again. p, then Enter: the plan's next."
    if task_of(setup) != following.task:
        return ""
    attempt = f"attempt {following.number} of {following.planned}"
    return f"x: {task_words(following.task, names)}, {attempt}. p shows the plan."


def task_of(setup: RunSetup) -> Task:
    return Task(setup.subject, setup.condition.number)
