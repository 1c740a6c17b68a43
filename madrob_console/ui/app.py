"""The console: keys in, acts to the engine."""

from __future__ import annotations

import getpass
import os
import shlex
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, ClassVar

from textual import events
from textual.app import App
from textual.binding import BindingType
from textual.message import Message
from textual.screen import Screen, SystemModalScreen
from textual.widget import MountError

from madrob_console.common.errors import MadrobError
from madrob_console.config.tables import ConsoleSettings
from madrob_console.engine.playback import PlaybackCommand
from madrob_console.engine.requests import (
    ExportDossier,
    ExportTeam,
    GiveFrames,
    OpenRun,
    Perform,
    TakeOver,
)
from madrob_console.referee.acts import Abort, Act, SetUp, Start
from madrob_console.referee.run import Phase
from madrob_console.ui.awaited import PendingRequests
from madrob_console.ui.cells.lines import Tone
from madrob_console.ui.frame.console_screen import ConsoleScreen
from madrob_console.ui.keys.console_questions import SelectedRun
from madrob_console.ui.keys.key_table import FUNCTION_KEYS, KEYS, PLAYBACK_KEYS, Key, bindings
from madrob_console.ui.keys.questions import NO_REASON, Ask, Copy, Intent, Leave, OtherName, Press
from madrob_console.ui.keys.result_questions import ask_void_instead
from madrob_console.ui.keys.run_questions import ask_abort
from madrob_console.ui.keys.terminal_driver import ConsoleDriver, KeysDropped
from madrob_console.ui.keys.terminal_input import MOST_KEYS
from madrob_console.ui.keys.type_ahead import UNSEEN, TypeAhead
from madrob_console.ui.link import NOT_YET, ConsoleDefaults, EngineLink, OpenClient, OpenReplay
from madrob_console.ui.look.themes import THEMES
from madrob_console.ui.look.words import done_text

if TYPE_CHECKING:
    from textual.command import Provider

    from madrob_console.engine.snapshot import Snapshot
    from madrob_console.ui.cells.dialog import Dialog
    from madrob_console.ui.panes.check_list import CheckList
    from madrob_console.ui.panes.list_pane import RunsPane
    from madrob_console.ui.panes.plan_pane import PlanPane
    from madrob_console.ui.panes.setup_pane import SetupPane

_OVER = {name for key in KEYS.values() if key.over for name in key.keys.split(",")}
"""Keys that work over a question and over the palette."""


def _is_over(event: events.Event) -> bool:
    return isinstance(event, events.Key) and event.key in _OVER


_OF_A_RUN = ("rule", "incident", "take_back")

LATEST = 1.0
"""Nothing starts after a set-up that took longer, s: nobody expects it any more."""

_WIDTHS = [(0, "-tiny-width"), (60, "-narrow"), (78, "-usual"), (100, "-wide")]
_HEIGHTS = [(0, "-tiny-height"), (18, "-short"), (28, "-high"), (32, "-tall")]


_DONE = {TakeOver.name: "This console has the right to act now.", PlaybackCommand.name: ""}
"""What is said when a command took effect; an export says it itself, when it is packed."""


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError):  # one without a name
        return str(os.getuid())


def console_commands() -> type[Provider]:
    from madrob_console.ui.keys.command_palette import ConsoleCommands

    return ConsoleCommands


class MadrobApp(App[None], inherit_bindings=False):
    """The referee's screens. They hold no rule: the engine says what is possible and why not.

    `open_client` is called in a thread once the screens are there. `monotonic` measures the
    engine's silence, s; `wall` is in s since the epoch. `failure` says
    why there is no engine, None while there is hope.
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
        open_client: OpenClient,
        defaults: ConsoleDefaults,
        look: ConsoleSettings | None = None,
        monotonic: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = time.time,
        ahead: TypeAhead | None = None,
        open_replay: OpenReplay | None = None,
    ) -> None:
        super().__init__(driver_class=ConsoleDriver)
        self.animation_level = "none"  # each frame would cross the line
        self._look = look or ConsoleSettings()
        for theme in THEMES:
            self.register_theme(theme)
        self.set_theme(self._look.theme)
        self.rings = self._look.bell
        self.failure: MadrobError | None = None
        self._monotonic = monotonic
        self._link = EngineLink(open_client, monotonic)
        self._ahead = ahead or TypeAhead()
        self._open_replay = open_replay
        self._waiting_f8: Message | None = None
        self._console = ConsoleScreen(self._link, defaults, self._ahead, wall)
        self._awaited = PendingRequests(
            self._link, self._console, partial(self.run_worker, group="keys")
        )

    def get_default_screen(self) -> Screen[None]:
        return self._console

    def on_ready(self) -> None:
        self.run_worker(self._connect, thread=True)

    def _connect(self) -> None:
        try:
            self._link.connect()
        except MadrobError as error:
            self.failure = error
            self.call_later(self.exit)
            return
        self.call_later(self.show_engine)

    async def show_engine(self) -> None:
        try:
            await self._console.begin_polling()
        except MountError:
            if self.return_code is None:  # else it is leaving: nothing can be mounted any more
                raise

    def close_link(self) -> None:
        self._link.close()

    def set_theme(self, name: str) -> None:
        self.theme = name
        if self.is_running:
            self._console.say(f"Theme: {name}.")

    def toggle_bell(self) -> None:
        self.rings = not self.rings
        self._console.say(f"The bell is {'on' if self.rings else 'off'}.")

    def ring(self) -> None:
        if self.rings:
            self.bell()

    def key_refusal(self, key: Key) -> str | None:
        snapshot = self._link.snapshot()
        return NOT_YET if snapshot is None else key.refusal(snapshot)

    def has_key(self, key: Key) -> bool:
        snapshot = self._link.snapshot()
        replays = snapshot is not None and snapshot.playback is not None
        return replays or key not in PLAYBACK_KEYS

    def post_message(self, message: Message) -> bool:
        """As Textual's; F8 throws away what was typed before it and still waits."""
        posted = super().post_message(message)
        pressed = isinstance(message, events.Key) and message.key == KEYS["abort"].keys
        if posted and pressed and self._waiting_f8 is None and not self._console.asks_abort:
            self._waiting_f8 = message
        return posted

    async def on_event(self, event: events.Event) -> None:
        """Drops what was typed or clicked for something that is no longer shown."""
        typed = isinstance(event, events.InputEvent | events.Paste)
        if event is self._waiting_f8:
            self._waiting_f8 = None
        elif typed and self._waiting_f8 is not None and not event.is_forwarded:
            return
        if typed and self.return_code is not None:
            return  # it is leaving: nothing can be opened any more
        if not typed or event.is_forwarded:
            palette = typed and isinstance(self.screen, SystemModalScreen)
            with suppress(*[KeyError] * palette):  # a page of commands that has no room for one
                await super().on_event(event)
        elif isinstance(self.screen, SystemModalScreen) and not (
            self._console.dialogs or _is_over(event)
        ):
            if self.screen.is_mounted:  # closed earlier, it would end in an error
                await super().on_event(event)
        elif not (
            self._leaves_out(event)
            or (self._console.dialogs and self._ask_first(event))
            or await self._escapes(event)
        ):
            await super().on_event(event)

    async def _escapes(self, event: events.Event) -> bool:
        """Carries Escape out at once: the next key is for what it leads to."""
        if not isinstance(event, events.Key) or event.key != "escape":
            return False
        active = self.screen.active_bindings.get("escape")
        if active is None:
            return False
        if not await self.run_action(active.binding.action, active.node):
            self._console.action_back()  # a list that is not filtered leaves Escape to the screen
        return True

    def _leaves_out(self, event: events.Event) -> bool:
        if not isinstance(event, events.Key | events.Paste | events.MouseDown | events.MouseUp):
            return False
        if not isinstance(event, events.MouseUp):
            self._console.key_pressed()
        if self._console.asks_abort:
            return False  # its own question alone judges them
        if (words := self._ahead.leaves_out(event)) is not None:
            self._console.leave_out(words)
        return words is not None

    def _ask_first(self, event: events.Event) -> bool:
        """Gives a question every key, paste and click, wherever the focus is.

        A modal screen of Textual would, too, but it repaints what changes behind it 60 times a
        second: 128 instead of 3 kB/s.
        """
        if isinstance(event, events.MouseEvent):
            return not self._console.is_clickable(event.screen_offset)
        if _is_over(event):
            return False
        if taken := isinstance(event, events.Key | events.Paste):
            self._console.dialogs[-1].take_input(event)
        return taken

    def on_keys_dropped(self, _event: KeysDropped) -> None:
        words = f"More than {MOST_KEYS} keys at once: the rest was left out."
        self.set_timer(UNSEEN, partial(self._console.leave_out, words))  # after those that count

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:
        key = KEYS.get(str(parameters[0])) if action == "press" and parameters else None
        if key in PLAYBACK_KEYS:
            return self._console.pane in key.where and self.has_key(key)
        return super().check_action(action, parameters)

    def action_command_palette(self) -> None:
        from madrob_console.ui.keys.command_palette import ConsolePalette

        if not isinstance(self.screen, ConsolePalette):
            self.push_screen(ConsolePalette())

    async def action_press(self, name: str, pressed: str) -> None:
        key = KEYS[name]
        if isinstance(self.screen, SystemModalScreen) and not key.over:
            return
        if key.name == "abort":
            self._press_abort(key)
        elif key.name == "leave" and not self._link.connected:
            self.exit()
        elif key.name in [dialog.name for dialog in self._console.dialogs]:
            return  # it is asked already
        elif key.name == "palette":
            self.action_command_palette()
        elif key.name == "engine":
            self._start_engine(key)
        elif key.pane:
            self._console.show_pane(key.pane)
        else:
            await self._awaited.soon(self._press_key(key, pressed), key.act or key.label)

    def _press_abort(self, key: Key) -> None:
        """Asks at once, whatever waits and whatever is open: y may be typed already."""
        if self.withdraw():
            return
        now = self._link.live_snapshot()
        if (refused := NOT_YET if now is None else key.refusal(now)) is not None:
            self._refuse_key(key, refused)
        elif now is not None:
            for dialog in [dialog for dialog in self._console.dialogs if dialog.name == key.name]:
                self._console.close(dialog)
            question = partial(key.question, pressed="")
            self._open_dialog(key, ask_abort(now, ""), question, self._link.live_snapshot)

    def _start_engine(self, key: Key) -> None:
        if (refused := self.key_refusal(key)) is not None:
            self._console.refuse(key.act, refused)
            return
        self._console.say("Starting the engine ...")

        def connect() -> None:
            try:
                self._link.connect()
            except MadrobError as error:
                self.call_later(self._console.refuse, key.act, str(error))
            else:
                self.call_later(self._console.say, "The engine is there again.", Tone.GOOD)

        self.run_worker(connect, thread=True, group="engine", exclusive=True)

    def _copy(self, copy: Copy) -> None:
        self.copy_to_clipboard(copy.text)  # of the referee's own machine, through SSH (OSC 52)
        tmux = "TMUX" in os.environ or os.environ.get("TERM", "").startswith("tmux")
        words = "Copied, if tmux has `set-clipboard on`" if tmux else "Copied"
        shown = f": {copy.text}" if "\n" not in copy.text else ""
        self._console.say(f"{words}: {copy.what}{shown}", Tone.GOOD)

    def withdraw(self) -> bool:
        return self._awaited.withdraw()

    async def _press_key(self, key: Key, pressed: str) -> None:
        """Does what a key says: the screen's own keys first, then those that ask for an act."""
        now = self._link.snapshot()
        if now is None:
            self._refuse_key(key, NOT_YET)
            return
        if key.act and now.notice is not None:
            key = KEYS["take"]  # nothing else is possible before
        if key.commits and (problem := await self._commit()):
            self._refuse_key(key, problem)
        elif (refused := self.key_refusal(key) or self._elsewhere(key)) is not None:
            self._refuse_key(key, refused)
        elif (now := self._link.snapshot()) is None or (intent := key.intent(now, pressed)) is None:
            await self._press_own(key)
        else:
            await self._ask(key, intent, partial(key.question, pressed=pressed))

    async def _press_own(self, key: Key) -> None:
        console, selected = self._console, self._console.selected_run()
        match key.name:
            case "menu":
                await self._ask(key, console.menu(), lambda _now: console.menu())
            case "copy":
                copy = console.ask_copy(_user())
                await self._ask(key, copy, lambda _now: copy)
            case "next" | "again":
                await self._next_run(key)
            case "export":
                await self._do(console.export, key.name, key.act)
            case _ if isinstance(selected, str):
                console.refuse(key.label, selected)
            case "open":
                if not console.ask_about(selected.folder):
                    await self._open_run(OpenRun(selected.folder))
            case "dossier":
                await self._do(ExportDossier(selected.folder), key.name, key.act)
            case "replay":
                self._show_replay(selected)

    def _show_replay(self, selected: SelectedRun) -> None:
        """Shows a replay in place of the testbed until it is left; never while a run goes on."""
        snapshot = self._link.snapshot()
        if snapshot is None or snapshot.run.active or snapshot.playback is not None:
            here = snapshot is not None and snapshot.playback is not None
            self._console.refuse("replay", "this is one" if here else "a run is going on")
            return
        open_replay = self._open_replay
        folder = self._console.results / selected.folder
        if open_replay is None:
            words = shlex.join(["madrob", "watch", "--testbed", "replay", str(folder)])
            self._console.say(f"Type in another terminal: {words}")
            return
        self._console.say("Opening the replay ...")

        def connect() -> None:
            try:
                self._link.show_replay(open_replay(folder, selected.at))
            except MadrobError as error:
                self.call_later(self._console.refuse, "replay", str(error))
            else:
                self.call_later(self._console.enter_replay)

        self.run_worker(connect, thread=True, group="engine", exclusive=True)

    async def _commit(self) -> str | None:
        pressed = self._monotonic()
        problem = await self._console.panes.setup.commit_edits()
        self._console.poll()
        if problem is None and (took := self._monotonic() - pressed) > LATEST:
            return f"the engine took {took:.0f} s to answer: press again"
        return problem

    def _elsewhere(self, key: Key) -> str | None:
        """Refuses a key in a list of many runs: it does not mean the run that is open."""
        if key.name in _OF_A_RUN and self._console.pane in ("history", "plan", "standings"):
            return "F4 shows the run that is open; Enter opens the marked one"
        return None

    async def _ask(
        self,
        key: Key,
        intent: Intent,
        question: Callable[[Snapshot], Ask | str],
    ) -> None:
        """Carries out `intent`, or asks first; `question` asks as things stand later."""
        if not isinstance(intent, Ask):
            await self._do(intent, key.name, key.act or key.label.lower())
        else:
            self._open_dialog(key, intent, question)

    def _open_dialog(
        self,
        key: Key,
        ask: Ask,
        question: Callable[[Snapshot], Ask | str],
        look: Callable[[], Snapshot | None] | None = None,
    ) -> None:
        if self._console.asks_abort and key.name != "abort":
            return  # it was pressed before F8
        tiny = self._console.tiny
        look = look or self._link.snapshot

        def fresh() -> Ask | str:
            snapshot = look()
            answer = NOT_YET if snapshot is None else question(snapshot)
            return answer.shortest if tiny and isinstance(answer, Ask) else answer

        self._console.open(key.name, ask.shortest if tiny else ask, fresh)

    async def _do(self, intent: Intent, name: str, what: str) -> None:
        match intent:
            case Leave() if self._link.leave_replay():
                self._console.leave_replay()
            case Leave():
                self.exit()
            case OtherName():
                self._console.panes.setup.take_name(intent)
            case str():
                self._console.refuse(what, intent)
            case Copy():
                self._copy(intent)
            case Ask():
                key, ask = KEYS[name], intent
                await self._ask(key, ask, lambda now: key.refusal(now) or ask)
            case OpenRun():
                await self._open_run(intent)
            case TakeOver() | PlaybackCommand() | ExportTeam() | ExportDossier():
                await self._awaited.carry_out(intent, _DONE.get(intent.name))
            case GiveFrames():
                await self._awaited.frames(intent)
            case Act():
                await self._act(intent, name)

    async def _act(self, act: Act, name: str) -> None:
        durable = not act.at_once
        now = self._link.live_snapshot() if isinstance(act, Abort) else self._link.snapshot()
        held = isinstance(act, Abort) and now is not None and now.right.holder
        if held and not await self._awaited.carry_out(TakeOver()):
            return
        words = done_text(act) + ("; z takes it back" if act.undoable else "")
        if isinstance(act, SetUp) and now is not None and now.run.unsigned:
            words += "; the result before is not final: h opens it"
        done = await self._awaited.carry_out(Perform.of(act), words, durable=durable)
        self._console.drafts.settle(name, refused=not done)
        if not done:
            if isinstance(act, Start):  # its number may be used now
                self._console.panes.setup.number_used = True
            elif isinstance(act, Abort):
                self.run_worker(self._void_instead(act.reason), group="keys")  # it is answered
            return
        if act.signature:
            self._console.panes.setup.remember_referee(act.signature)
        if name in ("next", "again"):
            self._console.show_pane("setup", chosen=False)

    async def _void_instead(self, reason: str) -> None:
        """If the run ended while its abort was confirmed, offers to void the run."""
        key, snapshot = KEYS["void"], self._link.snapshot()
        if snapshot is None or snapshot.run.phase is not Phase.STOPPED:
            return
        if key.refusal(snapshot) is None:
            void = ask_void_instead(reason)
            await self._ask(key, void, lambda now: key.refusal(now) or void)
            self._ahead.replaced("the question has just changed")

    async def _next_run(self, key: Key) -> None:
        form = self._console.panes.setup
        if key.name == "next":
            await form.propose_planned()
            if words := form.finished_words:
                self._console.say(words)
                return
        elif not self._console.take_marked_run():
            form.propose_same()
        setup = await form.draft()
        if isinstance(setup, str):
            self._console.show_pane("setup", chosen=False)
            self._console.refuse(key.act, setup)
        else:
            await self._do(SetUp(setup), key.name, key.act)

    async def on_dialog_answered(self, event: Dialog.Answered) -> None:
        dialog = event.dialog
        if dialog not in self._console.dialogs:
            return
        intent = dialog.ask.make(*dialog.answers)
        if isinstance(intent, str) and dialog.ask_again(intent):
            return
        self._console.close(dialog)
        if isinstance(intent, Press):
            await self.action_press(intent.name, intent.pressed)
            return
        if not isinstance(intent, Ask):
            self._ahead.closed()
        name = dialog.name or ""
        await self._awaited.soon(self._do(intent, name, name), name)

    def on_dialog_closed(self, event: Dialog.Closed) -> None:
        if event.dialog in self._console.dialogs:
            self._console.close(event.dialog)
            self._console.drafts.typed.clear()
            if not event.escape:
                self._ahead.closed()
            self._console.say("Closed: nothing was done.")

    async def on_dialog_passed(self, event: Dialog.Passed) -> None:
        if not self._console.asks_abort:
            await self.on_event(events.Key(event.key.key, event.key.character))

    async def on_dialog_too_late(self, event: Dialog.TooLate) -> None:
        """Says that the question is void; after a confirmed abort another act is offered."""
        dialog = event.dialog
        key = KEYS.get(dialog.name or "")
        self._console.refuse(OpenRun.name if key is None else key.act, dialog.overtaken)
        if key is KEYS["abort"] and event.confirmed and dialog in self._console.dialogs:
            self._console.close(dialog)
            await self._void_instead(", ".join(dialog.answers) or NO_REASON)

    async def on_check_list_chosen(self, event: CheckList.Chosen) -> None:
        key = KEYS["waive"]
        await self._awaited.soon(self._press_key(key, event.check), key.act)

    async def on_setup_pane_next_run(self, _event: SetupPane.NextRun) -> None:
        await self._awaited.soon(self._next_run(KEYS["next"]), KEYS["next"].act)

    def on_plan_pane_chosen(self, event: PlanPane.Chosen) -> None:
        self._console.panes.setup.propose_official(event.task)
        self._console.show_pane("setup", chosen=False)

    def on_setup_pane_naming(self, event: SetupPane.Naming) -> None:
        self._console.open("other name", event.ask)

    async def on_runs_pane_opened(self, event: RunsPane.Opened) -> None:
        """Shows the runs behind a standing, or asks what to do with the marked run."""
        from madrob_console.pages.tally import Standing
        from madrob_console.ui.panes.standings_pane import filter_for

        if isinstance(event.row, Standing):
            self._console.show_runs(filter_for(event.row))
        else:
            await self.action_press("menu", "enter")

    async def _open_run(self, run: OpenRun) -> None:
        self._console.say(f"Reading {run.folder} ...")
        if await self._awaited.carry_out(run):
            self._console.show_pane("results")
            self._console.say("An earlier run: Enter shows what can be done, h goes back.")

    def _refuse_key(self, key: Key, why: str) -> None:
        """What was typed after a refused key is dropped, text fields included."""
        if key in FUNCTION_KEYS:
            self._console.end_typing()
        self._ahead.refused(key.cap, why, answered=key.answered)
        self._console.refuse(key.act, why)
