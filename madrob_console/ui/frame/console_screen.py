"""The one screen: panes between what is always visible."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING, ClassVar, cast

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container
from textual.reactive import reactive
from textual.screen import Screen
from textual.timer import Timer
from textual.widgets import ContentSwitcher

from madrob_console.engine.requests import ExportTeam, OpenRun
from madrob_console.referee.acts import (
    Abort,
    AcceptFalseStart,
    DecideProtest,
    DeclareTimeout,
    FileProtest,
    Finalise,
    Reissue,
    RestartCountdown,
    SetUp,
    Start,
    WithdrawProtest,
)
from madrob_console.referee.competition_plan import plan_remarks
from madrob_console.referee.records import cause_of
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.controls import Label
from madrob_console.ui.cells.dialog import Drafts
from madrob_console.ui.cells.lines import TONE_CLASSES, Tone, View
from madrob_console.ui.frame.frame_lines import (
    FaultLine,
    PlaybackBar,
    StatusLine,
    TinyClock,
    TopLine,
)
from madrob_console.ui.frame.key_line import KeyLine
from madrob_console.ui.keys.console_questions import (
    SelectedRun,
    ask_copy,
    ask_false_start,
    ask_unfinished,
)
from madrob_console.ui.keys.key_table import KEYS, MENU, ask_menu, with_caps
from madrob_console.ui.link import NOT_YET
from madrob_console.ui.look.words import PHASES, export_text
from madrob_console.ui.panes.run_status import who_text

if TYPE_CHECKING:
    from pathlib import Path

    from textual import events
    from textual.geometry import Offset
    from textual.widget import Widget

    from madrob_console.engine.snapshot import Snapshot
    from madrob_console.ui.cells.dialog import Dialog, FreshAsk
    from madrob_console.ui.keys.console_app import ConsoleApp
    from madrob_console.ui.keys.questions import Ask
    from madrob_console.ui.keys.type_ahead import TypeAhead
    from madrob_console.ui.link import ConsoleDefaults, EngineLink
    from madrob_console.ui.panes.all_panes import Panes

BUSY_PERIOD = 0.1
"""Polling period while a countdown or a run goes on, s."""
IDLE_PERIOD = 0.25
"""Polling period otherwise, s."""

TOP_LINE_EVERY = 4
"""Every fourth snapshot of a run reaches the top line: its counters change with every one."""

_MAIN = ("setup", "live", "results")

_BY = {
    Phase.READY: (SetUp.name,),
    Phase.COUNTDOWN: (Start.name, RestartCountdown.name),
    Phase.STOPPED: (
        *(Abort.name, DeclareTimeout.name, Reissue.name, OpenRun.name),
        *(FileProtest.name, DecideProtest.name, WithdrawProtest.name),
    ),
    Phase.FINAL: (Finalise.name, OpenRun.name),
}
"""Acts that bring a run into a phase, if it does not come by itself."""

_ABOUT_NO_RUN = ("menu", "leave", "unfinished", "other name", "copy", "take")
"""Questions that are not about the current run."""

_STARTING = "Looking for the engine; one is started where none runs ..."
_WRITTEN = "The result is written. Enter: what next. x: next run."
_WRITTEN_FOR_WATCHERS = "The result is written."
_NOT_ON_DISK = "The result is NOT ON DISK yet: the engine has it and goes on trying."
_AT_THE_END = "The recording is at its end: < goes back, j jumps to a time."
_REPLAY_BEGINS = "A replay: F10 goes back, F8 aborts a run of the testbed, F1 lists the keys."
_REPLAY_ENDS = "The replay is over: this is the testbed again."
_OPEN_FIRST = "o opens it: then Enter signs, corrects, voids it or files a protest."


class ConsoleScreen(Screen[None]):
    """Top line, faults, one pane, status, keys; dialogs over the lower part of the pane.

    A terminal too small for that shows a clock with the keys that end a run. `ahead` is told
    when something else is shown by itself. `wall` gives the time in s since the epoch. The front
    one of `dialogs` is the last. `drafts` are texts of acts that were refused. `frames` is the
    last requested folder of camera frames; empty = none.
    """

    COMPONENT_CLASSES: ClassVar[set[str]] = TONE_CLASSES
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "back", show=False),
        # before the fields' own: what is typed next goes into the next field, however fast
        Binding("tab", "app.focus_next", show=False, priority=True),
        Binding("shift+tab", "app.focus_previous", show=False, priority=True),
    ]
    AUTO_FOCUS = ""
    focused: reactive[Widget | None] = reactive(None, repaint=False)  # the widgets show it

    def __init__(
        self,
        link: EngineLink,
        defaults: ConsoleDefaults,
        ahead: TypeAhead,
        wall: Callable[[], float],
    ) -> None:
        super().__init__()
        self._link = link
        self._ahead = ahead
        self._defaults = defaults
        self._top = TopLine()
        self._faults = FaultLine()
        self._playback = PlaybackBar()
        self._panes: Panes | None = None
        self._switcher = ContentSwitcher()
        self._starting = Label(_STARTING, id="engine-starting")
        self._tiny = TinyClock()
        self._status = StatusLine(defaults.hint, wall)
        self._keys = KeyLine()
        self._latest: Snapshot | None = None
        self.frames = ""
        self._timer: Timer | None = None
        self._count = 0
        self._asked_held: float | None = None
        self._was_active = False
        self._was_written = False
        self._behind = self._before_replay = "setup"
        self.pane = "setup"
        self.dialogs: list[Dialog] = []
        self.drafts = Drafts()

    def compose(self) -> ComposeResult:
        yield self._top
        yield self._playback
        yield self._faults
        yield Container(self._starting, self._switcher, self._tiny, id="body")
        yield self._status
        yield self._keys

    @property
    def tiny(self) -> bool:
        return self.has_class("-tiny-width") or self.has_class("-tiny-height")

    @property
    def status(self) -> str:
        return self._status.text

    @property
    def panes(self) -> Panes:
        """All panes; not before `begin_polling`."""
        assert self._panes is not None
        return self._panes

    @property
    def results(self) -> Path:
        return self._defaults.results

    @property
    def export(self) -> ExportTeam | str:
        """The runs of the marked run's team, or of that whose run is shown; else why none."""
        marked = self.panes.history.table.selected if self.pane == "history" else None
        if marked is not None:
            return ExportTeam(marked.subject, marked.practice, marked.competition)
        now = self._latest
        if now is None or (setup := now.run.setup) is None:
            return "no team is marked or set up: h shows all runs"
        return ExportTeam(setup.subject, now.practice, setup.competition)

    def menu(self) -> Ask | str:
        """Asks what to do with the marked run of the history, else with the one that is shown."""
        now = self._latest
        if now is None:
            return NOT_YET
        marked = self.panes.history.table.selected
        if self.pane == "history":
            team = "" if marked is None else f"{marked.subject} {marked.team}".rstrip()
            about = "" if marked is None else f"run {marked.run_number} of team {team}"
            pane, hint = self.pane, "" if now.right.only_watches else _OPEN_FIRST
        else:
            about, hint = "" if now.run.setup is None else who_text(now.run), ""
            pane = "live" if now.result is None else "results"
        choices = [(key, key.refusal(now)) for key in MENU if pane in key.where]
        if now.right.only_watches or now.playback is not None:
            choices, hint = [(key, why) for key, why in choices if why is None], ""
        choices = [(key, why) for key, why in choices if key.name != "take" or why is None]
        acts = (KEYS["rule"], KEYS["incident"], KEYS["take_back"])
        direct = [key for key in acts if pane in key.where and key.refusal(now) is None]
        which = f"What do you want to do with {about}?"
        title = which if about else "There is no run here. What do you want to do?"
        return ask_menu(title, choices, direct, hint)

    def selected_run(self) -> SelectedRun | str:
        """The marked run of the history, else the one that is shown; else why there is none."""
        if self.pane == "history":
            marked = self.panes.history.table.selected
            return "no run is marked" if marked is None else SelectedRun.of_list(marked)
        now = self._latest
        if now is None or now.folder is None:
            return "there is no run here: h shows all runs"
        if now.run.active:
            return "a run is going on"
        return SelectedRun.of_shown(now.folder, now.run)

    def ask_copy(self, user: str) -> Ask | str:
        """Asks what to copy on this pane; `user` can log in here."""
        now, panes = self._latest, self.panes
        if now is None:
            return NOT_YET
        folder, result, row = now.folder or "", "", ""
        if now.result is not None:
            panes.results.show(now)
            result = panes.results.copied
        if self.pane == "history":
            row, marked = panes.history.table.copied, panes.history.table.selected
            folder = "" if marked is None else str(self._defaults.results / marked.folder)
        elif self.pane == "standings":
            row = panes.standings.table.copied
        elif self.pane == "plan":
            row = panes.plan.copied
        zipped = now.export.path if now.export is not None else ""
        host = f"{user}@{self._defaults.host}"
        return ask_copy(row, result, folder, zipped, host, self.frames)

    def ask_about_unfinished(self) -> None:
        """Asks about the first run that was cut off, when this screen learns of it."""
        now = self._latest
        if now is not None and now.unfinished and not self.dialogs:
            self.ask_about(now.unfinished[0].folder)
            self._ahead.replaced("the question has just come")

    def ask_about_false_start(self) -> None:
        """Asks once about each held countdown where it can be decided; closes once it is."""
        now = self._latest
        for dialog in [
            dialog for dialog in self.dialogs if dialog.name == "accept" and dialog.overtaken
        ]:
            self.close(dialog)
        if now is None or now.run.held in (None, self._asked_held) or self.dialogs:
            return

        def question() -> Ask | str:
            now = self._latest
            if now is None:
                return NOT_YET
            return now.refusal(AcceptFalseStart.name) or ask_false_start(now.run)

        if not isinstance(ask := question(), str):
            self._asked_held = now.run.held
            self.show_pane("live", chosen=False)
            self.open("accept", ask, question)
            self._ahead.replaced("the question has just come")

    def ask_about(self, folder: str) -> bool:
        """Asks what becomes of a run that was cut off; False if nobody here can decide it."""

        def question() -> Ask | str:
            now = self._latest
            runs = () if now is None or now.refusal(SetUp.name) else now.unfinished
            asks = (ask_unfinished(run) for run in runs if run.folder == folder)
            return next(asks, "it is decided: another console has opened it")

        if isinstance(ask := question(), str):
            return False
        self.open("unfinished", ask, question)
        return True

    async def begin_polling(self) -> None:
        from madrob_console.ui.panes.all_panes import Panes

        panes = Panes(self._link, self._defaults)
        for pane in panes:
            pane.display = False
        with self.app.batch_update():
            self._starting.display = False
            await self._switcher.mount(*panes)
            self._switcher.current = self.pane
        self._panes = panes
        self._timer = self.set_interval(IDLE_PERIOD, self.poll)
        self.poll()
        self.take_focus(chosen=True)

    def poll(self) -> None:
        """Shows the latest snapshot; polls more often while a run goes on."""
        snapshot = self._link.snapshot()
        if snapshot is None or self._panes is None:
            return
        if snapshot.pulse.gone:  # a referee's key starts one where there is none
            self._link.look_for_engine(partial(self.run_worker, thread=True, group="next engine"))
        busy = self._latest is not None and self._latest.run.active
        self.show(snapshot)
        if snapshot.run.active != busy and self._timer is not None:
            self._timer.stop()
            period = BUSY_PERIOD if snapshot.run.active else IDLE_PERIOD
            self._timer = self.set_interval(period, self.poll)

    def enter_replay(self) -> None:
        self._before_replay = self.pane
        self._change_engine("live", _REPLAY_BEGINS)

    def leave_replay(self) -> None:
        self._change_engine(self._before_replay, _REPLAY_ENDS)

    def _change_engine(self, pane: str, words: str) -> None:
        """Shows another engine: nothing that differs has happened."""
        self._latest = None
        self.poll()
        if self.pane != pane:
            self.show_pane(pane)
        self.say(words, Tone.GOOD)

    def _tell_live_run(self) -> None:
        """While a replay is shown: says that a run goes on at the testbed."""
        live = self._link.live_snapshot()
        if live is not None and live.playback is None and live.run.active:
            self.say(f"{who_text(live.run)} GOES ON: F8 aborts it, F10 shows it.", Tone.BAD)

    def show(self, snapshot: Snapshot) -> None:
        before, self._latest = self._latest, snapshot
        if before is not None and _stage(before) != _stage(snapshot):
            self._status.pass_on()
            self._take_no_keys(before, snapshot)
        self._ring(before, snapshot)
        self._follow(before, snapshot)
        for dialog in self.dialogs:
            dialog.look_again()
        if before is None or (
            snapshot.run.phase is Phase.IDLE
            and (snapshot.unfinished != before.unfinished or before.pulse.gone)
        ):  # a slow disk tells of them after the first look; an engine that starts asks again
            self.call_later(self.ask_about_unfinished)
        self.call_later(self.ask_about_false_start)
        self._tell_export(before, snapshot)
        self._tell_lists(before, snapshot)
        self._playback.show(snapshot)
        if snapshot.playback is not None:
            self._tell_live_run()
        self._faults.show(snapshot)
        self._keys.show(snapshot)
        if self._count % TOP_LINE_EVERY == 0 or not snapshot.run.active:
            self._top.show(snapshot)
        self._count += 1
        self.panes[self.pane].show(snapshot)
        self._tiny.show(snapshot)
        if self.pane != "setup":
            self.panes.setup.follow(snapshot)
        self._hint_at_next(snapshot)

    def _hint_at_next(self, now: Snapshot) -> None:
        if not now.plan.lines or now.right.only_watches or now.run.phase is Phase.IDLE:
            return
        over = now.run.phase in (Phase.STOPPED, Phase.FINAL)
        hint = self.panes.setup.next_words if over else ""
        if hint != self._status.hint:
            self._status.hint = hint
            self._status.redraw()

    def _take_no_keys(self, before: Snapshot, now: Snapshot) -> None:
        """The run changed its state: drops keys typed before, unless a key caused the change.

        Keys for an open question or field still count.
        """
        phase = now.run.phase
        if phase is before.run.phase and now.opened == before.opened:
            return
        if now.run.active:
            self._status.hint = ""
        typing = self._types or bool(self.dialogs)
        if not typing and not self._link.asked_lately(*_BY.get(phase, ())):
            self._ahead.replaced(f"the run has just changed: {PHASES[phase].lower()}")

    def _tell_export(self, before: Snapshot | None, now: Snapshot) -> None:
        """Says what has become of an export; not of one that was there before this screen."""
        if before is not None and now.export is not None and now.export != before.export:
            exported, bad = bool(now.export.path), bool(now.export.problem)
            tone = (
                (Tone.WARN if exported else Tone.BAD)
                if bad
                else (Tone.GOOD if exported else Tone.PLAIN)
            )
            self.say(export_text(now.export), tone)

    def _tell_lists(self, before: Snapshot | None, now: Snapshot) -> None:
        """Says what is wrong with teams and plan, once, and that they have changed."""
        if now.right.only_watches:
            return
        read = list[str]()
        if before is not None and now.teams != before.teams:
            read.append(f"The list of teams was read again: {len(now.teams.names)} teams.")
        if before is not None and now.plan != before.plan:
            attempts = sum(line.attempts for line in now.plan.lines)
            read.append(f"The plan was read again: {attempts} attempts.")
        if read or before is None:
            said = now.teams.problems if before is None else self._notes(before)
            notes = [words for words in self._notes(now) if words not in said]
            if notes or read:
                self.say("; ".join(notes or read), Tone.WARN if notes else Tone.GOOD)

    def _notes(self, now: Snapshot) -> list[str]:
        """What is wrong with teams and plan."""
        remarks = plan_remarks(now.plan.lines, now.teams.names, self._defaults.run.timeout)
        return [*now.teams.notes, *now.plan.notes, *remarks]

    def on_descendant_focus(self) -> None:
        self._keys.typing, self._keys.asks = self._types and not self.dialogs, bool(self.dialogs)
        self._keys.redraw()

    @property
    def _types(self) -> bool:
        return self.focused is not None and self.focused.check_consume_key("x", "x")

    def on_descendant_blur(self) -> None:
        self.on_descendant_focus()

    def show_pane(self, name: str, *, chosen: bool = True) -> None:
        """Switches to a pane; the key of a side pane that is shown goes back.

        `chosen`: the referee wants to be there; a pane that comes by itself takes no text.
        """
        if self._panes is None:
            return
        if name == self.pane and name not in _MAIN:
            name, chosen = self._behind, False
        if name in _MAIN:
            self._behind = name
        elif name == "help":
            self.panes.help.take_pane(self.pane)
        if name != self.pane:
            for view in self.panes[self.pane].query(View):
                view.forget()
        self._switcher.current = self.pane = name
        self._keys.pane = name
        self._faults.whole_below = name == "live"
        self.take_focus(chosen=chosen)
        if self._latest is not None:
            self.panes[name].show(self._latest)
            self._keys.show(self._latest)
            self._faults.show(self._latest)

    def action_back(self) -> None:
        """Escape withdraws what waits for the disk, else leaves a field or side pane; no more."""
        if cast("ConsoleApp", self.app).withdraw():
            return
        if self._types:
            self.take_focus(chosen=False)
        elif self.pane not in _MAIN:
            self.show_pane(self._behind, chosen=False)

    def say(self, text: str, tone: Tone = Tone.PLAIN) -> None:
        self._status.say(text, tone)

    def refuse(self, what: str, why: str) -> None:
        self.say(f"Refused: {what}: {with_caps(why)}", Tone.BAD)

    def key_pressed(self) -> None:
        """Drops the message: it is about what was before."""
        self._status.go()

    def leave_out(self, words: str) -> None:
        """Says why a key was dropped, where it was to go."""
        if self.dialogs:
            self.dialogs[-1].complain(words)
        else:
            self.say(words, Tone.WARN)

    def on_key(self, event: events.Key) -> None:
        """A letter that only a menu has says how to press it, or why it is not possible."""
        now = self._latest
        if now is None or event.key in self.active_bindings:
            return
        for key in [key for key in MENU if key.cap == event.character]:
            there = "" if self.pane in key.where else f"{_caps(key.where)}, then "
            how, refused = f"press {there}Enter, then {key.cap}", key.refusal(now)
            self.say(f"{key.label}: {f'not now: {refused}' if refused else how}", Tone.WARN)

    def end_typing(self) -> None:
        if self._types and not self.dialogs:
            self.take_focus(chosen=False)

    def take_marked_run(self) -> bool:
        """In the history: the next run is for the team and the condition of the marked one."""
        if self.pane != "history" or (run := self.panes.history.table.selected) is None:
            return False
        self.panes.setup.propose_like(run)
        return True

    def show_runs(self, text: str) -> None:
        self.show_pane("history")
        self.panes.history.look_for(text)

    @property
    def asks_abort(self) -> bool:
        return bool(self.dialogs) and self.dialogs[-1].name == "abort"

    def take_focus(self, *, chosen: bool = False) -> None:
        """Gives the focus to what is in front; to a text field only if that was chosen."""
        if self.dialogs:
            return
        if self.pane == "setup" and not chosen:
            self.panes.setup.rest()
        else:
            self.panes[self.pane].enter()

    def open(self, name: str, ask: Ask, fresh: FreshAsk | None = None) -> None:
        """Opens a dialog in front of everything; `fresh` asks as things stand later.

        It has every key from now on, before it is drawn.
        """
        from madrob_console.ui.cells.dialog import Dialog

        ahead = self._ahead.of_one_question() if name == "abort" else self._ahead
        dialog = Dialog(name, ask, self._about(name), fresh, ahead, self.drafts)
        self.dialogs.append(dialog)
        self.query_one("#body").mount(dialog)
        self.on_descendant_focus()
        if (palette := self.app.screen) is not self:
            palette.call_after_refresh(self._close_palette)  # closed earlier, it ends in an error

    def _close_palette(self) -> None:
        if (palette := self.app.screen) is not self:
            self.app.workers.cancel_node(palette)  # one that looks for commands ends in an error
            self.app.pop_screen()

    def _about(self, name: str) -> str:
        latest = self._link.live_snapshot() if name == "abort" else self._latest
        if latest is None or name in _ABOUT_NO_RUN:
            return ""
        who = who_text(latest.run)
        attempt = self.panes.setup.attempt if name == "abort" else ""
        return f"{who}, {attempt}" if attempt else who

    def close(self, dialog: Dialog) -> None:
        """Closes a dialog, and what was opened over it but for the question of an abort."""
        if self.asks_abort and dialog in self.dialogs[:-1]:
            self.dialogs.remove(dialog)
            dialog.end()
        while dialog in self.dialogs:
            self.dialogs.pop().end()
        self.on_descendant_focus()
        self.take_focus()

    def is_clickable(self, at: Offset) -> bool:
        """Whether a click there counts: beside an open question the footer alone takes one."""
        return any(widget.region.contains_point(at) for widget in (*self.dialogs[-1:], self._keys))

    def _ring(self, before: Snapshot | None, now: Snapshot) -> None:
        """Rings when a run starts, is held or stops, or a fault appears; never for what is over."""
        if before is None or now.playback is not None:
            return
        started = now.run.phase is Phase.RUNNING is not before.run.phase
        stopped = before.run.active and not now.run.active
        faults = {*before.all_faults, now.pulse_words or "" if before.pulse.words else ""}
        new = {*map(cause_of, now.all_faults)} - {*map(cause_of, faults)}
        held = now.run.held not in (None, before.run.held)
        taken = now.notice is not None and now.notice != before.notice
        if started or stopped or held or taken or new:
            cast("ConsoleApp", self.app).ring()

    def _follow(self, before: Snapshot | None, now: Snapshot) -> None:
        """Live when a countdown begins, results when one is written; not under a dialog."""
        if self.dialogs:
            return
        active, written = now.run.active, now.result is not None or now.rescoring
        attached = before is None
        ending = now.run.phase is Phase.STOPPED and not written
        if (active and not self._was_active) or (attached and ending):
            self._status.pass_on()
            self.show_pane("live", chosen=False)
            if not self._link.asked_lately(*_BY[Phase.COUNTDOWN]):
                self._ahead.replaced("the screen has just changed")
        elif written and not self._was_written and (attached or self.pane == "live"):
            self.show_pane("results", chosen=False)
            self._ahead.replaced("the result has just come")
            if not self._status.grave:  # a refusal is the greater news
                watched = _WRITTEN_FOR_WATCHERS if now.right.only_watches else _WRITTEN
                said = _NOT_ON_DISK if now.pulse.unsaved else watched
                self.say(_AT_THE_END if now.playback else said)
        self._was_active, self._was_written = active, written


def _caps(panes: Iterable[str]) -> str:
    """The keys of panes: `F4 or h`."""
    return " or ".join(sorted(KEYS[pane].cap for pane in panes))


def _stage(snapshot: Snapshot) -> tuple[object, ...]:
    """What a message is about: when this changes, it is old."""
    return (snapshot.run.phase, snapshot.run.setup, snapshot.opened)
