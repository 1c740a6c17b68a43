"""The one screen: panes between what is always visible."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, cast

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Container
from textual.screen import Screen
from textual.timer import Timer
from textual.widgets import ContentSwitcher, Input

from madrob_console.referee.acts import SetUp
from madrob_console.referee.run import Phase
from madrob_console.ui.cells.label import Label
from madrob_console.ui.cells.lines import TONE_CLASSES, Tone, View
from madrob_console.ui.frame.fault_line import FaultLine
from madrob_console.ui.frame.key_line import KeyLine
from madrob_console.ui.frame.playback_bar import PlaybackBar
from madrob_console.ui.frame.tiny_clock import TinyClock
from madrob_console.ui.frame.top_line import TopLine
from madrob_console.ui.keys.asks import ask_unfinished
from madrob_console.ui.look.words import export_text
from madrob_console.ui.panes.run_status import who_text

if TYPE_CHECKING:
    from madrob_console.archive.history import RunSummary
    from madrob_console.engine.shown.snapshot import Snapshot
    from madrob_console.referee.questions import Ask
    from madrob_console.referee.run import RunSetup
    from madrob_console.standings.tally import Standing
    from madrob_console.ui.cells.dialog import Dialog
    from madrob_console.ui.defaults import ConsoleDefaults
    from madrob_console.ui.keys.asks import Intent
    from madrob_console.ui.keys.console_app import ConsoleApp
    from madrob_console.ui.link import EngineLink
    from madrob_console.ui.panes.all_panes import Panes

BUSY_PERIOD = 0.1
"""Between two looks at the engine while a countdown or a run goes on, s."""
IDLE_PERIOD = 0.25
"""The same otherwise, s."""

TOP_LINE_EVERY = 4
"""Every fourth snapshot of a run reaches the top line: its counters change with every one."""

_MAIN = ("setup", "live", "results")

_WRITTEN = "The result is written: f finalises it, x the next run, PgDn shows more."
_AT_THE_END = "The recording is at its end: < goes back, j jumps to a time, PgDn shows more."


class ConsoleScreen(Screen[None]):
    """Top line, faults, one pane, status, keys; dialogs over the lower part of the pane.

    In a terminal too small for that, a clock with the keys that end a run.

    Args:
        link: to the engine.
        defaults: what the first run's set-up proposes.

    Attributes:
        pane: the name of the pane shown.
        dialogs: those that are open, the front one last.
    """

    COMPONENT_CLASSES: ClassVar[set[str]] = TONE_CLASSES
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "back", show=False),
        # before the fields' own: what is typed next goes into the next field, however fast
        Binding("tab", "app.focus_next", show=False, priority=True),
        Binding("shift+tab", "app.focus_previous", show=False, priority=True),
    ]
    AUTO_FOCUS = ""

    def __init__(self, link: EngineLink, defaults: ConsoleDefaults) -> None:
        super().__init__()
        self._link = link
        self._defaults = defaults
        where = " @".join(name for name in (defaults.competition, defaults.host) if name)
        self._top = TopLine(where)
        self._faults = FaultLine(where)
        self._playback = PlaybackBar()
        self._panes: Panes | None = None
        self._switcher = ContentSwitcher()
        self._tiny = TinyClock()
        hint = "; ".join(defaults.problems) or defaults.hint
        self._status = Label(hint, Tone.WARN if defaults.problems else Tone.DIM, id="status-line")
        self._keys = KeyLine()
        self._latest: Snapshot | None = None
        self._timer: Timer | None = None
        self._count = 0
        self._was_active = False
        self._was_written = False
        self._behind = "setup"
        self.pane = "setup"
        self.dialogs: list[Dialog] = []

    def compose(self) -> ComposeResult:
        """Top to bottom."""
        yield self._top
        yield self._playback
        yield self._faults
        yield Container(self._switcher, self._tiny, id="body")
        yield self._status
        yield self._keys

    @property
    def tiny(self) -> bool:
        """Whether the terminal is too small for the panes."""
        return self.has_class("-tiny-width") or self.has_class("-tiny-height")

    @property
    def status(self) -> str:
        """The message shown."""
        return self._status.text

    @property
    def panes(self) -> Panes:
        """All panes; not before `begin`."""
        assert self._panes is not None
        return self._panes

    @property
    def team(self) -> int | str:
        """The number of the marked team, or of that whose run is shown; else why there is none."""
        match self.pane:
            case "history":
                shown: RunSummary | Standing | RunSetup | None = self.panes.history.selected
            case "standings":
                shown = self.panes.standings.selected
            case _:
                shown = None if self._latest is None else self._latest.run.setup
        return "no team is marked or set up: h shows all runs" if shown is None else shown.subject

    async def ask_about_unfinished(self) -> None:
        """The first run that was cut off, where the referee may decide about it."""
        now = self._latest
        if now is None or self.dialogs or now.refusal(SetUp.name):
            return
        if now.unfinished:
            await self.open("unfinished", ask_unfinished(now.unfinished[0]))

    async def begin(self) -> None:
        """Make the panes and poll the engine from now on."""
        from madrob_console.ui.panes.all_panes import Panes

        panes = Panes(self._link, self._defaults)
        for pane in panes:
            pane.display = False
        with self.app.batch_update():
            await self._switcher.mount(*panes)
            self._switcher.current = self.pane
        self._panes = panes
        self._timer = self.set_interval(IDLE_PERIOD, self.poll)
        self.poll()
        self.take_focus()
        await self.ask_about_unfinished()

    def poll(self) -> None:
        """Show the latest snapshot; look more often while a run goes on."""
        snapshot = self._link.snapshot()
        if snapshot is None or self._panes is None:
            return
        busy = self._latest is not None and self._latest.run.active
        self.show(snapshot, self._link.trouble)
        if snapshot.run.active != busy and self._timer is not None:
            self._timer.stop()
            period = BUSY_PERIOD if snapshot.run.active else IDLE_PERIOD
            self._timer = self.set_interval(period, self.poll)

    def show(self, snapshot: Snapshot, trouble: str | None = None) -> None:
        """Show a newer snapshot; `trouble` says why it cannot be trusted."""
        before, self._latest = self._latest, snapshot
        if before is not None and _stage(before) != _stage(snapshot):
            self.say("")  # what was said is about something else
        self._ring(before, snapshot)
        self._follow(before, snapshot)
        self._tell_export(before, snapshot)
        self._playback.show(snapshot)
        self._faults.trouble = trouble
        self._faults.show(snapshot)
        self._keys.show(snapshot)
        if self._count % TOP_LINE_EVERY == 0 or not snapshot.run.active:
            self._top.show(snapshot)
        self._count += 1
        self.panes[self.pane].show(snapshot)
        self._tiny.show(snapshot)
        if self.pane != "setup":
            self.panes.setup.follow(snapshot)

    def _tell_export(self, before: Snapshot | None, now: Snapshot) -> None:
        """Say what has become of an export; not of one that was there before this screen."""
        if before is not None and now.export is not None and now.export != before.export:
            made, bad = bool(now.export.path), bool(now.export.problem)
            tone = (Tone.WARN if made else Tone.BAD) if bad else (Tone.GOOD if made else Tone.PLAIN)
            self.say(export_text(now.export, self._defaults.results), tone)

    def on_descendant_focus(self) -> None:
        """The footer says whether letters type."""
        self._keys.typing = isinstance(self.focused, Input) and not self.dialogs
        self._keys.redraw()

    def on_descendant_blur(self) -> None:
        """The same."""
        self.on_descendant_focus()

    def show_pane(self, name: str) -> None:
        """Switch to a pane; the key of a side pane that is shown goes back."""
        if self._panes is None:
            return
        if name == self.pane and name not in _MAIN:
            name = self._behind
        if name in _MAIN:
            self._behind = name
        if name != self.pane:
            for view in self.panes[self.pane].query(View):
                view.forget()
        self._switcher.current = self.pane = name
        self._keys.pane = name
        self.take_focus()
        if self._latest is not None:
            self.panes[name].show(self._latest)
            self._keys.show(self._latest)

    def action_back(self) -> None:
        """Escape: out of a field, or from a side pane to the one before; it never does more."""
        if isinstance(self.focused, Input):
            self.set_focus(None)
        elif self.pane not in _MAIN:
            self.show_pane(self._behind)

    def say(self, text: str, tone: Tone = Tone.PLAIN) -> None:
        """Show a message until the next one."""
        self._status.say(text, tone)

    def take_marked_run(self) -> None:
        """In the history: the next run is for the team and condition of the marked one."""
        marked = self.panes.history.selected if self.pane == "history" else None
        if marked is not None:
            self.panes.setup.propose_like(marked)

    def show_runs(self, text: str) -> None:
        """The history with a filter."""
        self.show_pane("history")
        self.panes.history.look_for(text)

    def take_focus(self) -> None:
        """Give the focus to what is in front."""
        if self.dialogs:
            self.dialogs[-1].take_focus()
            return
        self.panes[self.pane].enter()

    async def open(self, name: str, ask: Ask[Intent]) -> None:
        """Open a dialog in front of everything."""
        from madrob_console.ui.cells.dialog import Dialog

        dialog = Dialog(name, ask, self._about(name))
        self.dialogs.append(dialog)
        await self.query_one("#body").mount(dialog)
        dialog.take_focus()

    def _about(self, name: str) -> str:
        """Which run a question is about."""
        if self._latest is None or name in ("next", "leave", "unfinished"):
            return ""
        return who_text(self._latest.run)

    async def close(self, dialog: Dialog) -> None:
        """Close a dialog; the focus goes to what was behind it."""
        if dialog in self.dialogs:
            self.dialogs.remove(dialog)
            await dialog.remove()
            self.take_focus()

    def _ring(self, before: Snapshot | None, now: Snapshot) -> None:
        """The bell: a run starts, a run stops, a fault appears; never for what is over."""
        if before is None or now.playback is not None:
            return
        started = now.run.phase is Phase.RUNNING is not before.run.phase
        stopped = before.run.active and not now.run.active
        if started or stopped or set(now.all_faults) - set(before.all_faults):
            cast("ConsoleApp", self.app).ring()

    def _follow(self, before: Snapshot | None, now: Snapshot) -> None:
        """Live when a countdown begins, results when one is written; not under a dialog."""
        if self.dialogs:
            return
        active, written = now.run.active, now.result is not None
        attached = before is None
        ending = now.run.phase is Phase.STOPPED and not written
        if (active and not self._was_active) or (attached and ending):
            self.show_pane("live")
        elif written and not self._was_written and (attached or self.pane == "live"):
            self.show_pane("results")
            if self._status.tone is not Tone.BAD:  # a refusal is the greater news
                self.say(_AT_THE_END if now.playback else _WRITTEN)
        self._was_active, self._was_written = active, written


def _stage(snapshot: Snapshot) -> tuple[object, ...]:
    """What a message is about: when this changes, it is old."""
    return (snapshot.run.phase, snapshot.run.setup, snapshot.opened)
