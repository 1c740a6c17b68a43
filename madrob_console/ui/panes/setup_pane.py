"""The set-up pane: the fields of the next run and the pre-start checks."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from msgspec.structs import asdict
from textual.actions import SkipAction
from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.message import Message
from textual.widgets import Input

from madrob_console.config.tables import start_pose_on
from madrob_console.engine.shown.requests import NextRunNumber, Perform
from madrob_console.errors import MadrobError
from madrob_console.referee.acts import SetUp, Start
from madrob_console.referee.run import Phase, RunSetup
from madrob_console.ui.cells.choice import Choice
from madrob_console.ui.cells.label import Label
from madrob_console.ui.cells.lines import Tone
from madrob_console.ui.cells.push_button import PushButton
from madrob_console.ui.defaults import FIRST_CONDITION, ConsoleDefaults
from madrob_console.ui.link import NOT_YET, EngineLink
from madrob_console.ui.panes.checklist import CheckList
from madrob_console.ui.panes.setup_form import SetupForm
from scoring.protocol import Condition

if TYPE_CHECKING:
    from madrob_console.archive.history import RunSummary
    from madrob_console.engine.shown.snapshot import Snapshot

_OPEN = (Phase.IDLE, Phase.READY)


class SetupPane(Vertical):
    """What the fields say is set up when a field is left, so that no change waits unseen.

    After a run the fields are a draft for the next one, set up only when asked for.
    """

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up", "focus_step(-1)", show=False),
        Binding("down", "focus_step(1)", show=False),
        Binding("enter", "enter", show=False),
        # in a field, before its own: what is typed next goes into the next one, however fast
        Binding("up", "leave_field(-1)", show=False, priority=True),
        Binding("down", "leave_field(1)", show=False, priority=True),
        Binding("enter", "leave_field(1)", show=False, priority=True),
    ]

    class NextRun(Message):
        """The referee asks for the next run."""

    def __init__(self, link: EngineLink, defaults: ConsoleDefaults) -> None:
        super().__init__(id="setup")
        self._link = link
        self._defaults = defaults
        self._teams = dict(defaults.teams)
        self._snapshot: Snapshot | None = None
        self._proposed: tuple[int, int] | None = None
        self._problem = ""
        self._no_number = ""
        self._untouched: RunSetup | str = ""
        self._form = SetupForm(defaults)
        self._button = PushButton("Set up this run", id="set-up")
        self._state = Label(id="setup-state")
        self._checks = CheckList()

    def compose(self) -> ComposeResult:
        """Fields, what becomes of them, checks."""
        yield self._form
        yield Horizontal(self._button, self._state, id="setup-row")
        yield self._checks

    def enter(self) -> None:
        """Where typing begins."""
        self.screen.set_focus(self._form.subject)

    def follow(self, snapshot: Snapshot) -> None:
        """Keep the proposal up to date, in view or not."""
        before, self._snapshot = self._snapshot, snapshot
        self.disabled = snapshot.run.active
        if before is None:
            self._load(snapshot)
            self._untouched = self._form.read()
        elif before.run.active and not snapshot.run.active:
            self._propose(again=True)
            self._untouched = self._form.read()

    def show(self, snapshot: Snapshot) -> None:
        """Show a newer snapshot."""
        self.follow(snapshot)
        run = snapshot.run
        self._button.say("Set up this run" if run.phase in _OPEN else "Set up the next run")
        self._state.say(*self._state_text(snapshot))
        self._checks.show(snapshot)

    def commit(self) -> str | None:
        """Set the run up as the fields say; returns why that is not possible."""
        self._snapshot = self._link.snapshot()
        if self._snapshot is None:
            return NOT_YET
        run = self._snapshot.run
        setup = self.draft()
        if run.phase not in _OPEN:
            return None  # a draft for the next run
        if isinstance(setup, str):
            return setup
        self._form.show_names(setup)
        self._untouched = setup
        self._problem = "" if setup == run.setup else self._link.do(Perform.of(SetUp(setup))) or ""
        return self._problem or None

    def commit_edits(self) -> str | None:
        """Before an act on a run that is set up: what has been typed since counts."""
        snapshot = self._link.snapshot()
        if snapshot is None or snapshot.run.phase not in _OPEN:
            return None
        if snapshot.run.phase is Phase.READY:
            return self.commit()
        draft = self.draft()
        return draft if isinstance(draft, str) else None

    def remember_referee(self, name: str) -> None:
        """Propose the name of who signed."""
        if not self._form.referee.value.strip():
            self._form.referee.value = name

    def propose_like(self, run: RunSummary) -> None:
        """Propose the team and the condition of an earlier run, with the next run number."""
        self._teams.setdefault(run.subject, run.team)
        self._form.subject.value = str(run.subject)
        self._form.take_condition(Condition.from_number(run.condition))
        self._propose(again=True)

    def draft(self) -> RunSetup | str:
        """The set-up in the fields, or what is wrong with it."""
        self._propose()
        setup = self._form.read()
        if isinstance(setup, RunSetup):
            self._teams[setup.subject] = setup.team
        return setup

    def on_input_changed(self, _event: Input.Changed) -> None:
        """Check while typing."""
        self._problem = ""
        self._form.show_derived()
        if self._snapshot is not None:
            self._state.say(*self._state_text(self._snapshot))

    def on_input_blurred(self, _event: Input.Blurred) -> None:
        """A field that is left counts, where something was typed."""
        if self._form.read() != self._untouched:
            self.commit()

    def on_choice_changed(self, event: Choice.Changed) -> None:
        """A choice counts at once."""
        if event.choice is self._form.preset:
            self._form.take_preset()
        elif event.choice is self._form.starting:
            self._form.follow_side()
        self._form.show_derived()
        self.commit()

    def on_push_button_pressed(self, _event: PushButton.Pressed) -> None:
        """Set up, or ask for the next run."""
        if self._snapshot is not None and self._snapshot.run.phase in _OPEN:
            self.commit()
        else:
            self.post_message(self.NextRun())

    def on_check_list_left(self, _event: CheckList.Left) -> None:
        """Up from the first check."""
        self.action_focus_step(-1)

    def action_enter(self) -> None:
        """What the fields say counts; go to the next."""
        self.commit()
        self.action_focus_step(1)

    def action_leave_field(self, step: int) -> None:
        """From a field to the next or the one before; what it says counts.

        Raises:
            SkipAction: no field has the focus.
        """
        if not isinstance(self.screen.focused, Input):
            raise SkipAction
        self.commit()
        self.action_focus_step(step)

    def action_focus_step(self, step: int) -> None:
        """The field after or before."""
        (self.screen.focus_next if step > 0 else self.screen.focus_previous)()

    def _load(self, snapshot: Snapshot) -> None:
        setup = snapshot.run.setup
        if setup is None:
            self._form.load(self._first_setup())
            self._propose(again=True)
            return
        self._form.load(setup)
        self._teams[setup.subject] = setup.team
        self._proposed = (setup.subject, setup.condition.number)
        if not snapshot.run.active and snapshot.run.phase not in _OPEN:
            self._propose(again=True)

    def _first_setup(self) -> RunSetup:
        known = self._defaults
        return RunSetup(
            subject=1,
            team=known.team or self._teams.get(1, ""),
            run_number=1,
            condition=FIRST_CONDITION,
            start_pose=start_pose_on(FIRST_CONDITION.starting_side, known.poses),
            referee=known.referee,
            **asdict(known.run),
        )

    def _propose(self, *, again: bool = False) -> None:
        """The next run number and the team's name, when subject or condition are others."""
        text = self._form.subject.value.strip()
        if not (text.isascii() and text.isdigit()):
            return
        wanted = (int(text), self._form.condition.number)
        if wanted == self._proposed and not again:
            return
        if self._proposed is not None and wanted[0] != self._proposed[0]:
            self._form.team.value = self._teams.get(wanted[0], "")
        self._proposed = wanted
        try:
            number = self._link.ask(NextRunNumber(*wanted))
        except MadrobError as error:
            self._no_number = str(error)
        else:
            self._no_number, self._form.run_number.value = "", str(number)

    def _state_text(self, snapshot: Snapshot) -> tuple[str, Tone]:
        run = snapshot.run
        if snapshot.playback is not None:
            return "A replay: nothing is set up here. F3 shows the run.", Tone.WARN
        if run.active:
            return f"Not editable now: {run.phase}. F3 shows the run.", Tone.WARN
        setup = self._form.read()
        if isinstance(setup, str) or self._problem or self._no_number:
            wrong = setup if isinstance(setup, str) else self._problem or self._no_number
            return f"x {wrong}", Tone.BAD
        if run.phase not in _OPEN:
            return f"Draft of run {setup.run_number}; x or Enter here sets it up.", Tone.PLAIN
        if setup != run.setup:
            return "Not set up yet: Enter, here or in a field.", Tone.WARN
        refused = snapshot.refusal(Start.name)
        then = "F5 starts." if refused is None else "See the checks."
        if not run.pose_confirmed:
            then = "F6 confirms its pose."
        if self._defaults.teams and setup.subject not in self._defaults.teams:
            then += f" Subject {setup.subject} has no name in the list of teams!"
        return f"Run {setup.run_number} of subject {setup.subject} is set up. {then}", Tone.GOOD
