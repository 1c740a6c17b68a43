"""The console: polls the engine, hands in acts."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, ClassVar

from textual.app import App
from textual.binding import BindingType
from textual.screen import Screen
from textual.timer import Timer

from madrob_console.referee.acts import Act
from madrob_console.ui.asks import ask_next_run, ask_waiver
from madrob_console.ui.defaults import ConsoleDefaults
from madrob_console.ui.keys import KEYS, Answer, Key, bindings
from madrob_console.ui.link import EngineLink
from madrob_console.ui.questions import Ask, Leave
from madrob_console.ui.screens.console import ConsoleScreen
from madrob_console.ui.screens.setup import SetupPane
from madrob_console.ui.widgets.checklist import CheckList
from madrob_console.ui.widgets.dialog import Dialog
from madrob_console.ui.widgets.lines import Tone
from madrob_console.ui.words import done_text

if TYPE_CHECKING:
    from madrob_console.engine.client import EngineClient

BUSY_PERIOD = 0.1
"""Between two looks at the engine while a countdown or a run goes on, s."""
IDLE_PERIOD = 0.25
"""The same otherwise, s."""

_WIDTHS = [(0, "-narrow"), (110, "-wide")]
_HEIGHTS = [(0, "-short"), (32, "-tall")]


class MadrobApp(App[None], inherit_bindings=False):
    """The referee's screens. They hold no rule: the engine says what is possible and why not.

    Args:
        client: the engine.
        defaults: what the first run's set-up proposes.
        monotonic: a clock for the engine's silence, s.

    Raises:
        MadrobError: the engine gives no snapshot.
    """

    TITLE = "madrob"
    CSS_PATH: ClassVar[list[str | PurePath]] = [*sorted(Path(__file__).parent.rglob("*.tcss"))]
    BINDINGS: ClassVar[list[BindingType]] = [*bindings()]
    HORIZONTAL_BREAKPOINTS = _WIDTHS
    VERTICAL_BREAKPOINTS = _HEIGHTS
    ENABLE_COMMAND_PALETTE = False

    def __init__(
        self,
        client: EngineClient,
        defaults: ConsoleDefaults,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        colourless = "NO_COLOR" in os.environ  # textual takes it out of the environment
        super().__init__(ansi_color=True if colourless else None)
        self.theme = "ansi-dark" if colourless else "textual-dark"
        self._link = EngineLink(client, monotonic)
        self._console = ConsoleScreen(self._link, defaults)
        self._timer: Timer | None = None
        self._busy = False

    def get_default_screen(self) -> Screen[None]:
        """The console."""
        return self._console

    def on_ready(self) -> None:
        """Begin to poll once everything is in place."""
        self._timer = self.set_interval(IDLE_PERIOD, self.poll)
        self.poll()
        self._console.take_focus()

    def poll(self) -> None:
        """Show the latest snapshot; more often while a run goes on."""
        snapshot = self._link.snapshot()
        self._console.show(snapshot, self._link.trouble)
        if snapshot.run.active != self._busy and self._timer is not None:
            self._busy = snapshot.run.active
            self._timer.stop()
            self._timer = self.set_interval(BUSY_PERIOD if self._busy else IDLE_PERIOD, self.poll)

    def act(self, act: Act) -> bool:
        """Hand in an act and say what became of it; returns whether it took effect."""
        refused = self._link.act(act)
        if refused is None:
            self._console.say(done_text(act), Tone.GOOD)
        else:
            self._refuse(act.name, refused)
        self.poll()
        return refused is None

    async def action_press(self, name: str, pressed: str) -> None:
        """A key of the console was pressed."""
        if self._timer is None:  # typed before the screens are there
            return
        key = KEYS[name]
        if self._console.dialogs and not self._over_dialogs(key):
            return
        if key.pane:
            self._console.show_pane(key.pane)
            return
        if key.commits and (problem := self._console.setup.commit_edits()):
            self._refuse(key.act, problem)
            return
        if key.name == "next":
            await self._next_run()
            return
        snapshot = self._link.snapshot()
        if (refused := key.refusal(snapshot)) is not None:
            self._refuse(key.act, refused)
        elif key.answer is not None:
            await self._take(key, key.answer(snapshot, pressed))

    def _over_dialogs(self, key: Key) -> bool:
        """Whether a key may come before the question that is open."""
        if key.over and all(dialog.name != key.name for dialog in self._console.dialogs):
            return True
        self._console.say("A question is open: answer it, or Escape closes it.", Tone.WARN)
        return False

    async def _take(self, key: Key, answer: Answer) -> None:
        match answer:
            case Ask():
                await self._console.open(key.name, answer)
            case Leave():
                self.exit()
            case Act():
                self.act(answer)
            case str():
                self._refuse(key.act, answer)

    async def _next_run(self) -> None:
        setup = self._console.setup.draft()
        if isinstance(setup, str):
            self._refuse(KEYS["next"].act, setup)
            self._console.show_pane("setup")
            return
        snapshot = self._link.snapshot()
        if (refused := KEYS["next"].refusal(snapshot)) is not None:
            self._refuse(KEYS["next"].act, refused)
            return
        answer = ask_next_run(snapshot, setup)
        await self._take(KEYS["next"], answer)
        if isinstance(answer, Act):
            self._console.show_pane("setup")

    async def on_dialog_answered(self, event: Dialog.Answered) -> None:
        """Do what the answers say."""
        await self._console.close(event.dialog)
        deed = event.dialog.ask.deed(*event.answers)
        if isinstance(deed, Leave):
            self.exit()
        elif self.act(deed) and event.dialog.name == "next":
            self._console.show_pane("setup")

    async def on_dialog_closed(self, event: Dialog.Closed) -> None:
        """Nothing happens."""
        await self._console.close(event.dialog)
        self._console.say("Closed: nothing was done.")

    async def on_check_list_chosen(self, event: CheckList.Chosen) -> None:
        """Waive the check that is marked in the list."""
        key, snapshot = KEYS["waive"], self._link.snapshot()
        if (refused := key.refusal(snapshot)) is not None:
            self._refuse(key.act, refused)
        else:
            await self._take(key, ask_waiver(snapshot, event.check))

    async def on_setup_pane_next_run(self, _event: SetupPane.NextRun) -> None:
        """The last field of the set-up asks for the next run."""
        await self._next_run()

    def _refuse(self, what: str, why: str) -> None:
        self._console.say(f"Refused: {what}: {why}", Tone.BAD)
