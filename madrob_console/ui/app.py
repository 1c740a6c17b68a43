"""The console: keys in, acts to the engine."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, ClassVar

from textual.app import App
from textual.binding import BindingType
from textual.filter import LineFilter
from textual.screen import Screen

from madrob_console.config.tables import ConsoleSettings
from madrob_console.engine.shown.playback import PlaybackCommand
from madrob_console.engine.shown.requests import ExportTeam, OpenRun, Perform, TakeOver
from madrob_console.errors import MadrobError
from madrob_console.kinds import ThemeName
from madrob_console.referee.acts import Act, SetUp, Waive
from madrob_console.referee.questions import Ask
from madrob_console.ui.cells.lines import Tone
from madrob_console.ui.defaults import ConsoleDefaults
from madrob_console.ui.frame.console_screen import ConsoleScreen
from madrob_console.ui.keys.asks import Intent, Leave
from madrob_console.ui.keys.key_table import KEYS, LETTER_KEYS, PLAYBACK_KEYS, Key, bindings
from madrob_console.ui.link import NOT_YET, EngineLink
from madrob_console.ui.look.glyphs import ASCII, uses_ascii
from madrob_console.ui.look.themes import COLOURLESS, NO_COLOURS, THEMES, theme_for
from madrob_console.ui.look.words import done_text

if TYPE_CHECKING:
    from textual.command import Provider

    from madrob_console.engine.shown.client import EngineClient
    from madrob_console.ui.cells.dialog import Dialog
    from madrob_console.ui.cells.field import NumberField
    from madrob_console.ui.panes.checklist import CheckList
    from madrob_console.ui.panes.runs_pane import RunsPane
    from madrob_console.ui.panes.setup_pane import SetupPane

_WIDTHS = [(0, "-tiny-width"), (60, "-narrow"), (78, "-usual"), (110, "-wide")]
_HEIGHTS = [(0, "-tiny-height"), (18, "-short"), (32, "-tall")]


def console_commands() -> type[Provider]:
    """The palette's commands, imported when they are wanted."""
    from madrob_console.ui.palette import ConsoleCommands

    return ConsoleCommands


class MadrobApp(App[None], inherit_bindings=False):
    """The referee's screens. They hold no rule: the engine says what is possible and why not.

    Args:
        open_client: connects to the engine; called once the screens are there, off their loop.
        defaults: what the first run's set-up proposes.
        look: theme, characters, bell.
        monotonic: a clock for the engine's silence, s.

    Attributes:
        ascii: whether only ASCII characters are drawn.
        rings: whether the bell rings.
        failure: why there is no engine; None while there is hope.
    """

    TITLE = "madrob"
    CSS_PATH: ClassVar[list[str | PurePath]] = [*sorted(Path(__file__).parent.rglob("*.tcss"))]
    BINDINGS: ClassVar[list[BindingType]] = [*bindings()]
    COMMANDS = {console_commands}  # noqa: RUF012  textual's declaration
    COMMAND_PALETTE_BINDING = "ctrl+p"
    HORIZONTAL_BREAKPOINTS = _WIDTHS
    VERTICAL_BREAKPOINTS = _HEIGHTS

    def __init__(
        self,
        open_client: Callable[[], EngineClient],
        defaults: ConsoleDefaults,
        look: ConsoleSettings | None = None,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        environ = os.environ.copy()
        os.environ.pop("NO_COLOR", None)  # textual makes it grey; the themes make it colourless
        super().__init__()
        self._look = look or ConsoleSettings()
        self._environ = environ
        for theme in THEMES:
            self.register_theme(theme)
        self.set_theme(self._look.theme)
        self.ascii = uses_ascii(environ, self._look.ascii)
        self.rings = self._look.bell
        self.failure: MadrobError | None = None
        self._link = EngineLink(open_client, monotonic)
        self._console = ConsoleScreen(self._link, defaults)

    def get_default_screen(self) -> Screen[None]:
        """The console."""
        return self._console

    def get_line_filters(self) -> Sequence[LineFilter]:
        """With those that bring all that is drawn down to what the terminal can show."""
        return [
            *super().get_line_filters(),
            *([NO_COLOURS] if self.theme == COLOURLESS else []),
            *([ASCII] if self.ascii else []),
        ]

    def on_ready(self) -> None:
        """Connect to the engine once the screens can be seen."""
        self.run_worker(self._connect, thread=True)

    def _connect(self) -> None:
        try:
            self._link.connect()
        except MadrobError as error:
            self.failure = error
            self.call_later(self.exit)
            return
        self.call_later(self._console.begin)

    def close_link(self) -> None:
        """Let the engine go, after the screens have."""
        self._link.close()

    def set_theme(self, name: ThemeName) -> None:
        """Change the colours, as far as the terminal has them."""
        self.theme = theme_for(name, self._environ)
        if self.is_running:
            self._console.say(f"Theme: {name}.")

    def toggle_bell(self) -> None:
        """Ring, or be silent."""
        self.rings = not self.rings
        self._console.say(f"The bell is {'on' if self.rings else 'off'}.")

    def ring(self) -> None:
        """Ring the terminal's bell, where that is wanted."""
        if self.rings:
            self.bell()

    def key_refusal(self, key: Key) -> str | None:
        """Why a key does nothing now; None when it does."""
        snapshot = self._link.snapshot()
        return NOT_YET if snapshot is None else key.refusal(snapshot)

    def has_key(self, key: Key) -> bool:
        """Whether there is such a key now: those of a replay are there on a replay only."""
        snapshot = self._link.snapshot()
        replays = snapshot is not None and snapshot.playback is not None
        return replays or key not in PLAYBACK_KEYS

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        """Leave the keys of a replay to the panes wherever they move none."""
        key = KEYS.get(str(parameters[0])) if action == "press" and parameters else None
        if key in PLAYBACK_KEYS:
            return self._console.pane in key.where and self.has_key(key)
        return super().check_action(action, parameters)

    async def action_press(self, name: str, pressed: str) -> None:
        """A key of the console was pressed."""
        key = KEYS[name]
        if self.screen is not self._console:
            if not key.over:
                return
            self.pop_screen()  # what is urgent does not wait for the palette
        if key.name == "leave" and not self._link.connected:
            self.exit()
        elif self._console.dialogs and not self._over_dialogs(key):
            return
        elif key.name == "menu":
            self.action_command_palette()
        elif key.pane:
            self._console.show_pane(key.pane)
        else:
            await self._press_act(key, pressed)

    async def _press_act(self, key: Key, pressed: str) -> None:
        if not self._link.connected:
            self._refuse(key.act, NOT_YET)
        elif key.commits and (problem := self._commit()):
            self._refuse(key.act, problem)
        elif key.name == "next":
            await self._next_run()
        elif key.name == "take" and self.key_refusal(key) is None:
            await self._do(TakeOver(), key.name, key.act)
        elif key.name == "export" and self.key_refusal(key) is None:
            team = self._console.team
            await self._do(ExportTeam(team) if isinstance(team, int) else team, key.name, key.act)
        elif (refused := self.key_refusal(key) or self._elsewhere(key)) is not None:
            self._refuse(key.act, refused)
        elif key.ask is not None and (snapshot := self._link.snapshot()) is not None:
            await self._ask(key, key.ask(snapshot, pressed))

    def _commit(self) -> str | None:
        """What is typed in the set-up counts; returns what is wrong with it."""
        problem = self._console.panes.setup.commit_edits()
        self._console.poll()
        return problem

    def _elsewhere(self, key: Key) -> str | None:
        """Among many runs, a key is not for the one that happens to be open."""
        if self._console.pane in ("history", "standings") and key in LETTER_KEYS:
            return "Enter opens the marked run first, F4 shows the one that is open"
        return None

    def _over_dialogs(self, key: Key) -> bool:
        """Whether a key may come before the question that is open."""
        if key.over and all(dialog.name != key.name for dialog in self._console.dialogs):
            return True
        self._console.say("A question is open: answer it, or Escape closes it.", Tone.WARN)
        return False

    async def _ask(self, key: Key, intent: Intent | Ask[Intent]) -> None:
        """Do at once what a key brings about, or ask first."""
        if isinstance(intent, Ask):
            await self._console.open(key.name, intent.shortest if self._console.tiny else intent)
        else:
            await self._do(intent, key.name, key.act)

    async def _do(self, intent: Intent, name: str, what: str) -> None:
        """Do what a key or a dialog of that name brings about; `what` a refusal is of."""
        match intent:
            case Leave():
                self.exit()
            case str():
                self._refuse(what, intent)
            case OpenRun():
                await self._open_run(intent)
            case PlaybackCommand():
                await self._request(intent, "")  # its bar shows what became of it
            case TakeOver():
                await self._request(intent, "This console has the right to act now.")
            case ExportTeam():
                await self._request(intent)  # the snapshot says when the zip is there
            case Act():
                await self._act(intent, name)

    async def _act(self, act: Act, name: str) -> None:
        if not await self._request(Perform.of(act), done_text(act)):
            return
        if act.signature:
            self._console.panes.setup.remember_referee(act.signature)
        if name == "next":
            self._console.show_pane("setup")

    async def _request(
        self,
        command: Perform | OpenRun | PlaybackCommand | TakeOver | ExportTeam,
        done: str | None = None,
    ) -> bool:
        """Have something done, say what became of it, and return whether it took effect.

        The screens go on while the engine's disk makes it wait.
        """
        refused = await asyncio.to_thread(self._link.do, command)
        self._console.poll()  # first: a change of phase wipes the message
        if refused is not None:
            self._refuse(command.name, refused)
        elif done is not None:
            self._console.say(done, Tone.GOOD)
        return refused is None

    async def _next_run(self) -> None:
        key = KEYS["next"]
        self._console.take_marked_run()
        setup = self._console.panes.setup.draft()
        if isinstance(setup, str):
            self._refuse(key.act, setup)
            self._console.show_pane("setup")
            return
        if (refused := self.key_refusal(key)) is not None:
            self._refuse(key.act, refused)
            return
        snapshot = self._link.snapshot()
        assert snapshot is not None
        await self._ask(key, SetUp(setup).unless_final(snapshot))

    async def on_dialog_answered(self, event: Dialog.Answered) -> None:
        """Do what the answers say."""
        dialog = event.dialog
        await self._console.close(dialog)
        name = dialog.name or ""
        await self._do(dialog.ask.make(*event.answers), name, name)

    async def on_dialog_closed(self, event: Dialog.Closed) -> None:
        """Nothing happens."""
        await self._console.close(event.dialog)
        self._console.say("Closed: nothing was done.")

    async def on_check_list_chosen(self, event: CheckList.Chosen) -> None:
        """Waive the check that is marked in the list."""
        key = KEYS["waive"]
        if (refused := self.key_refusal(key)) is not None:
            self._refuse(key.act, refused)
        elif (snapshot := self._link.snapshot()) is not None:
            await self._ask(key, Waive.ask_why(snapshot, event.check))

    async def on_setup_pane_next_run(self, _event: SetupPane.NextRun) -> None:
        """The last field of the set-up asks for the next run."""
        await self._next_run()

    async def on_runs_pane_opened(self, event: RunsPane.Opened) -> None:
        """Show an earlier run, whose bag takes a moment to read, or the runs behind a standing."""
        from madrob_console.standings.tally import Standing
        from madrob_console.ui.panes.standings_pane import filter_for

        if isinstance(event.row, Standing):
            self._console.show_runs(filter_for(event.row))
        else:
            await self._open_run(OpenRun(event.row.folder))

    async def _open_run(self, run: OpenRun) -> None:
        self._console.say(f"Reading {run.folder} ...")
        if await self._request(run):
            self._console.show_pane("results")
            self._console.say(
                "An earlier run: 1-6 f u n go on with it, h goes back, x the next run."
            )

    def on_number_field_refused(self, event: NumberField.Refused) -> None:
        """A letter typed into a number."""
        what = f"'{event.letter}' is no number: Escape leaves the field, then letters are keys"
        self._console.say(what, Tone.WARN)

    def _refuse(self, what: str, why: str) -> None:
        self._console.say(f"Refused: {what}: {why}", Tone.BAD)
