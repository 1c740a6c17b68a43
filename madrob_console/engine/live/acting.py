"""Acts of the referee: judged against the situation, and carried out, each at most once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from madrob_console.archive.folders import give_out_run_number
from madrob_console.engine.live.answers import Answers, Told
from madrob_console.engine.live.course import Happening
from madrob_console.engine.live.durable import DurableActs
from madrob_console.engine.live.equipment import Equipment
from madrob_console.engine.live.run_at_hand import RunAtHand
from madrob_console.engine.live.run_recorder import OpenRecording
from madrob_console.referee.acts import (
    ACTS,
    Abort,
    Act,
    Consequence,
    Correct,
    Situation,
    act_details,
    refusals,
)
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change, after
from madrob_console.referee.run import Phase, Run


class Acting:
    """Does the referee's acts to the run at hand.

    Args:
        equipment: what the engine works with.
        at_hand: the run.
        situation: what acts are judged against.
        advance: called when something was done: judges at once what follows from it.

    Attributes:
        durable: those that wait for the disk.
    """

    def __init__(
        self,
        equipment: Equipment,
        at_hand: RunAtHand,
        situation: Callable[[], Situation],
        advance: Callable[[], None],
    ) -> None:
        self._equipment = equipment
        self._at_hand = at_hand
        self._situation = situation
        self._advance = advance
        self._answers = Answers()
        self.durable = DurableActs(
            equipment, at_hand.chronicle, at_hand.recorder, situation, self._take_effect
        )

    @property
    def waiting(self) -> type[Act] | None:
        """The act that takes effect when it is on disk; None = none. From any thread."""
        return self.durable.waiting

    def refusals(self, situation: Situation) -> dict[str, str]:
        """Act name -> why there can be no such act now; those that are possible are missing."""
        found, active = refusals(situation), situation.run.active
        for act in ACTS:
            if act.name not in found and (why := self.durable.refusal(act, active=active)):
                found[act.name] = why
        if self.waiting is not None and not active:
            found.pop(Abort.name, None)
        return found

    def submit(self, act: Act, done: Told, name: str, origin: Origin = Origin.REFEREE) -> None:
        """Do an act, if it is possible: at once, or when its line is on disk.

        Args:
            act: what to do.
            done: told once: why it was refused, in words, or None when it took effect.
            name: its id; one that is known is answered again, not done twice. Empty = none.
            origin: who asks.
        """
        answer = self._answers.expect(name, done)
        if answer is not None:
            self._judge(act, answer, name, origin)

    def _judge(self, act: Act, answer: Told, name: str, origin: Origin) -> None:
        durable, run = self.durable, self._at_hand.run
        if durable.waiting is not None and isinstance(act, Abort) and not run.active:
            starts = Consequence.COUNTDOWN in durable.waiting.consequences
            who = "the referee" if origin is Origin.REFEREE else "an abort over ROS"
            why = "aborted before the countdown began" if starts else f"taken back by {who}"
            why = f"{why}: {act.reason}".rstrip(": ")
            if durable.withdraw_or(why, then=lambda: self._judge(act, answer, name, origin)):
                answer(None)
        elif refused := act.refusal(self._situation()) or durable.refusal(act, active=run.active):
            answer(refused)
        elif act.at_once or self._waits_for_start(act):
            self._do(act, origin)
            answer(None)
        else:
            name, at = name or f"{self._equipment.clock.now_ns():x}", self._equipment.now()
            act, prepare = self._completed(act)
            durable.submit(act, lambda act: _line_of(act, run, at, origin, name), answer, prepare)

    def _waits_for_start(self, act: Act) -> bool:
        """Whether its line does, and not for a disk: before its start a run has no journal there.

        A start itself does not.
        """
        return self._at_hand.folder is None and Consequence.RECORDING not in act.consequences

    def _completed(self, act: Act) -> tuple[Act, Callable[[], Act] | None]:
        """An act with what only the engine knows, and what completes it on the disk, if any."""
        if not isinstance(act, Correct):
            return act.settled(self._situation()), None
        at_hand, act = self._at_hand, act.named(self._situation())
        number = at_hand.run.number_in(act.subject, act.condition)
        if number is not None:
            return act.numbered(number), None
        assert at_hand.folder is not None
        return act, partial(_numbered, act, at_hand.folder.parent)

    def _do(self, act: Act, origin: Origin) -> None:
        """An act that takes effect whatever the disk says."""
        brings, at, situation = act.consequences, self._equipment.now(), self._situation()
        at_hand, act = self._at_hand, act.settled(situation)
        if Consequence.NEW_RUN in brings:
            at_hand.begin_next()
            situation = replace(situation, run=at_hand.run)
        run = act.apply(situation, at)
        at_hand.write(_line_of(act, run, at, origin))
        if Consequence.HANDLE_ZERO in brings:
            at_hand.kept = run.cleared
        if Consequence.NEW_RUN in brings:
            assert run.setup is not None
            self._equipment.source.configure(run.setup.condition)
            at_hand.chronicle.announce_start_pose(run.setup.start_pose)
        self._done(run)

    def _take_effect(self, act: Act, entry: Entry, made: OpenRecording | None) -> None:
        """An act whose line is on disk."""
        at_hand = self._at_hand
        if made is not None:
            at_hand.adopt(made)
        at_hand.chronicle.say(entry, at_hand.run.start)
        if Consequence.COUNTDOWN in act.consequences:
            details = {"time": self._equipment.now()}
            begins = at_hand.note(Happening(Origin.CLOCK, Change.COUNTDOWN_BEGINS, details=details))
            self._done(after(at_hand.run, begins))
        else:
            self._done(act.apply(self._situation(), entry.time))

    def _done(self, run: Run) -> None:
        """What the run is after an act."""
        at_hand = self._at_hand
        before = at_hand.run.phase
        at_hand.go_on(run)
        if at_hand.result.wanted and Phase.STOPPED in (before, run.phase):
            at_hand.score()  # but what was final stays as it was signed
        self._advance()


def _numbered(act: Correct, results: Path) -> Act:
    """A correction with a run number that was never used; it waits for the disk.

    Raises:
        MadrobError: all are used, or the disk refuses.
    """
    number = give_out_run_number(results, act.subject, act.condition.number)
    return act.numbered(number)


def _line_of(act: Act, run: Run, at: float, origin: Origin, name: str = "") -> Entry:
    referee = run.referee if origin is Origin.REFEREE else ""
    return Entry(at, origin, act.name, referee, act.reason_given, act_details(act), name)
