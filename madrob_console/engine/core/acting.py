"""Acts of the referee: judged, carried out at most once, at once or when their line is on disk."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum, auto
from pathlib import Path

from madrob_console.archive.run_record import RunRecord
from madrob_console.common.names import SourceKind
from madrob_console.engine.core.current_run import CurrentRun
from madrob_console.engine.core.effects import (
    Answer,
    CloseJournal,
    ConfigureTestbed,
    Effect,
    GiveOutNumber,
    GiveUpRecording,
    KeepRecording,
    OpenRecording,
    Publish,
    ReopenJournal,
    WithdrawLine,
    WriteLine,
)
from madrob_console.engine.core.inputs import (
    DoAct,
    JournalReopened,
    LineWithdrawn,
    LineWritten,
    NumberGivenOut,
    OpenEarlierRun,
    RecordingOpened,
)
from madrob_console.engine.core.now import Now
from madrob_console.engine.core.run_tracker import Happening
from madrob_console.engine.core.situations import SituationFactory
from madrob_console.referee.acts import (
    ACTS,
    Abort,
    Act,
    Consequence,
    Correct,
    Finalise,
    act_details,
    refusals,
)
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change, after
from madrob_console.referee.run import Phase, Run, begin_countdown

DURABLE_WITHIN = 2.0
"""A line that is not on disk after this is withdrawn, s."""

SILENT = 1.0
"""A disk without an answer for this long gets nothing new, s."""

OWN_RUN = "a replay shows its own run: leave it to open another one"
GOES_ON = "a run is going on"


class _Wait(Enum):
    """What an act waits for: a run number, the files of its run, or its line on disk."""

    NUMBER = auto()
    FILES = auto()
    LINE = auto()


@dataclass(eq=False)
class _Pending:
    """An act that waits for the disk until its `deadline`, s of the monotonic clock.

    Attributes:
        place: how many lines stood when its line was handed to the disk.
        record, folder: of the run that it starts.
        aborts: that came too late to withdraw it, and are judged after it.
    """

    request: DoAct
    entry: Entry
    deadline: float
    wait: _Wait
    place: int
    record: RunRecord | None = None
    folder: Path | None = None
    aborts: list[DoAct] = field(default_factory=list)


class Acting:
    """Does the referee's acts to the current run, one durable act at a time.

    What it wants done is added to `effects`.
    """

    def __init__(
        self, situations: SituationFactory, current_run: CurrentRun, effects: list[Effect]
    ) -> None:
        self._situations = situations
        self._current = current_run
        self._effects = effects
        self._pending: _Pending | None = None

    @property
    def waiting(self) -> type[Act] | None:
        """The act that waits for the disk. From any thread."""
        pending = self._pending
        return None if pending is None else type(pending.request.act)

    def refusals(self, now: Now) -> dict[str, str]:
        """Act name -> why no such act is possible now; those that are possible are missing."""
        situation = self._situations.at(now)
        refused, active = refusals(situation), situation.run.active
        for act in ACTS:
            if act.name not in refused and (why := self._disk_refusal(act, now)):
                refused[act.name] = why
        if self.waiting is not None and not active:
            refused.pop(Abort.name, None)
        return refused

    def _disk_refusal(self, act: Act | type[Act], now: Now) -> str | None:
        """Why the disk allows no such act now, in words."""
        ends = act.urgent or act.name == Finalise.name or Consequence.NEW_RUN in act.consequences
        if self._current.state.lines.is_full and not ends:
            return "the journal of this run is full: sign it, then set up the next run"
        if self.waiting is not None and not (act.at_once and self._current.run.active):
            return f"the disk has not taken the {self.waiting.name} yet: wait for it"
        if not act.at_once and (silent := now.disk.silent) > SILENT:
            return f"the disk has not answered for {silent:.0f} s: nothing new until it does"
        return None

    # ------------------------------------------------------------------ an act that comes

    def do(self, request: DoAct, now: Now) -> None:
        """Do an act, if it is possible: at once, or when its line is on disk."""
        act, run, pending = request.act, self._current.run, self._pending
        if pending is not None and isinstance(act, Abort) and not run.active:
            pending.aborts.append(request)
            self._withdraw(pending, _abort_words(request, pending), now)
        elif refused := act.refusal(self._situations.at(now)) or self._disk_refusal(act, now):
            self._answer(request, refused)
        elif act.at_once or self._waits_for_start(act):
            self._do_at_once(request, now)
            self._answer(request, None)
        else:
            self._begin_waiting(request, now)

    def _answer(self, request: DoAct | OpenEarlierRun, refused: str | None) -> None:
        self._effects.append(Answer(request.number, refused))

    def _waits_for_start(self, act: Act) -> bool:
        """Whether its line waits for the start, before which a run has no journal on disk."""
        return self._current.state.folder is None and Consequence.RECORDING not in act.consequences

    def _do_at_once(self, request: DoAct, now: Now) -> None:
        current, situation = self._current, self._situations.at(now)
        act = request.act.settled(situation)
        if Consequence.NEW_RUN in act.consequences:
            current.begin_next()
            situation = replace(situation, run=current.run)
        run = act.apply(situation, now.time)
        current.write(_line_of(act, run, now.time))
        if Consequence.HANDLE_ZERO in act.consequences:
            current.zeroed = run.cleared
        if Consequence.NEW_RUN in act.consequences:
            assert run.setup is not None
            self._effects.append(ConfigureTestbed(run.setup.condition))
            self._effects.append(Publish(run.setup.start_pose))
        self._change(run, now)

    def _change(self, run: Run, now: Now) -> None:
        before = self._current.run.phase
        self._current.change(run, (), now)
        if self._current.state.result.is_wanted and Phase.STOPPED in (before, run.phase):
            self._current.score(now)  # what was final and stays final is not scored again

    # ------------------------------------------------------------------ an act that waits

    def _begin_waiting(self, request: DoAct, now: Now) -> None:
        current, situation, act = self._current, self._situations.at(now), request.act
        number = None
        if isinstance(act, Correct):
            act = act.named(situation)
            number = current.run.number_in(act.subject, act.condition)
            act = act if number is None else act.numbered(number)
        else:
            act = act.settled(situation)
        request = replace(request, act=act, id=request.id or f"{round(now.time * 1e9):x}")
        entry = _line_of(act, current.run, now.time, request.id)
        deadline = now.monotonic + DURABLE_WITHIN
        pending = _Pending(request, entry, deadline, _Wait.LINE, len(current.state.lines))
        self._pending = pending
        if Consequence.RECORDING in act.consequences:
            pending.wait, pending.record = _Wait.FILES, self._record(now)
            start = begin_countdown(current.run, now.time).start
            assert start is not None
            lines = (*current.state.lines.entries, entry)
            self._effects.append(OpenRecording(pending.record, start, lines))
        elif isinstance(act, Correct) and number is None:
            pending.wait = _Wait.NUMBER
            assert current.state.folder is not None
            results = current.state.folder.parent
            self._effects.append(GiveOutNumber(request.id, results, act.subject, act.condition))
        else:
            self._effects.append(WriteLine(entry, awaited=True))

    def _record(self, now: Now) -> RunRecord:
        run, config, testbed = self._current.run, self._situations.config, now.testbed
        assert run.setup is not None
        simulated = testbed.announcement.simulated is not None
        return RunRecord(
            setup=run.setup,
            handle_zero=run.handle_zero,
            thresholds=config.thresholds,
            mappings=config.mappings,
            source=SourceKind.SIMULATED if simulated else testbed.kind,
            competition=config.competition,
            version=config.version,
            zero_samples=run.zero_samples,
        )

    def take_number(self, reserved: NumberGivenOut, now: Now) -> None:
        """Complete a correction with its run number, and have its line written."""
        pending = self._pending
        if pending is None or pending.request.id != reserved.id:
            return  # it was withdrawn
        if reserved.problem is not None:
            self._decide(pending, reserved.problem, now)
            return
        act, before = pending.request.act, pending.entry
        assert isinstance(act, Correct)
        pending.request = replace(pending.request, act=act.numbered(reserved.number))
        pending.entry = _line_of(pending.request.act, self._current.run, before.time, before.id)
        pending.wait, pending.place = _Wait.LINE, len(self._current.state.lines)
        self._effects.append(WriteLine(pending.entry, awaited=True))

    def take_written(self, written: LineWritten, now: Now) -> None:
        """Carry out the act whose line is on disk, if it is still possible."""
        pending = self._pending
        if pending is not None and pending.entry.id == written.id:
            self._decide(pending, written.problem, now)

    def take_recording(self, opened: RecordingOpened, now: Now) -> None:
        """Begin the run whose files are open, if that is still possible."""
        pending = self._pending
        if pending is not None and pending.entry.id == opened.id:
            pending.folder = opened.folder
            self._decide(pending, opened.problem, now)

    def _decide(self, pending: _Pending, problem: str | None, now: Now) -> None:
        """The disk has answered: carry the act out, if it is still possible."""
        self._pending = None
        act, starts = pending.request.act, pending.wait is _Wait.FILES
        refused = problem or act.refusal(self._situations.at(now))
        if refused and problem is None:
            withdrawal = _withdrawal(pending, refused, now)
            if starts:
                self._effects.append(GiveUpRecording(withdrawal))
            else:
                self._current.write(withdrawal)
        if not refused:
            self._take_effect(pending, now)
        self._answer(pending.request, refused or None)
        for request in pending.aborts:
            self.do(request, now)

    def _take_effect(self, pending: _Pending, now: Now) -> None:
        act, current = pending.request.act, self._current
        state = current.state
        state.lines = state.lines.with_line(pending.entry, pending.place)
        if pending.wait is _Wait.FILES:
            state.record, state.folder, state.recording = pending.record, pending.folder, True
            self._effects.append(KeepRecording())
        current.publish(pending.entry)
        if Consequence.COUNTDOWN in act.consequences:
            begins = Happening(Origin.CLOCK, Change.COUNTDOWN_BEGINS, details={"time": now.time})
            self._change(after(current.run, current.note(begins, now)), now)
        else:
            self._change(act.apply(self._situations.at(now), pending.entry.time), now)

    # ------------------------------------------------------------------ an act that is withdrawn

    def withdraw_overdue(self, now: Now) -> None:
        """Withdraw the act that waits, if it waits too long or is no longer possible."""
        pending = self._pending
        if pending is None:
            return
        why = None
        if now.monotonic >= pending.deadline:
            why = f"the disk did not take it within {DURABLE_WITHIN:g} s"
        elif pending.wait is not _Wait.NUMBER:
            why = pending.request.act.refusal(self._situations.at(now))
        if why:
            self._withdraw(pending, why, now)

    def withdraw(self, why: str, now: Now) -> None:
        """Withdraw the act that waits, if one does."""
        if self._pending is not None:
            self._withdraw(self._pending, why, now)

    def _withdraw(self, pending: _Pending, why: str, now: Now) -> None:
        self._effects.append(WithdrawLine(_withdrawal(pending, why, now)))

    def take_withdrawal(self, withdrawn: LineWithdrawn) -> None:
        """The act that waited never takes effect; it was not on disk yet."""
        pending, withdrawal = self._pending, withdrawn.withdrawal
        if pending is None or pending.entry.id != withdrawal.details["id"]:
            return
        self._pending = None
        if pending.wait is _Wait.FILES:
            self._current.log.add_line(withdrawal, None)
        elif pending.wait is _Wait.LINE:
            self._current.write(withdrawal)
        self._answer(pending.request, f"{withdrawal.reason}: it is withdrawn")
        for request in pending.aborts:
            self._answer(request, None)

    # ------------------------------------------------------------------ an earlier run

    def opening_refusal(self, now: Now, instead_of: int | None = None) -> str | None:
        """Why no earlier run can be opened now, in words; `instead_of`: see `OpenEarlierRun`."""
        current, result = self._current, self._current.state.result
        if current.run.active or self._pending is not None:
            return GOES_ON
        if current.run.phase in (Phase.STOPPED, Phase.FINAL) and not (
            result.is_settled or now.workers.hopeless
        ):
            return "the result of the last run is being written"
        if instead_of not in (None, current.generation):
            return current.replaced_words
        return None

    def open_earlier(self, request: OpenEarlierRun, now: Now) -> None:
        refused = self.opening_refusal(now, request.instead_of)
        if refused is not None or request.earlier.folder == self._current.state.folder:
            self._answer(request, refused)
        else:
            self._effects.append(ReopenJournal(request))

    def take_journal(self, reopened: JournalReopened, now: Now) -> None:
        """Go on in the journal of an earlier run, in time or not at all."""
        request, refused = reopened.request, reopened.problem
        if refused is None:
            refused = self.opening_refusal(now, request.instead_of)
            if reopened.late:
                refused = f"the disk took more than {DURABLE_WITHIN:g} s: try again"
            if refused is None:
                self._current.open_earlier(request, now)
            else:
                self._effects.append(CloseJournal())
        self._answer(request, refused)


def _withdrawal(pending: _Pending, why: str, now: Now) -> Entry:
    details = {"id": pending.entry.id, "act": pending.request.act.name}
    return Entry(now.time, Origin.SYSTEM, Change.WITHDRAWN, reason=why, details=details)


def _abort_words(abort: DoAct, pending: _Pending) -> str:
    starts = Consequence.COUNTDOWN in pending.request.act.consequences
    why = "aborted before the countdown began" if starts else "taken back by the referee"
    return f"{why}: {abort.act.reason_given}".rstrip(": ")


def _line_of(act: Act, run: Run, at: float, name: str = "") -> Entry:
    return Entry(
        at, Origin.REFEREE, act.name, run.referee, act.reason_given, act_details(act), name
    )
