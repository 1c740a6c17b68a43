"""A run as a referee leads it, on an engine to which something may happen at any moment.

All that is asked is noted with its answer, so that it can be compared with what is on disk.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from madrob_console.archive.check import check_run
from madrob_console.archive.folders import (
    JOURNAL_FILE,
    NUMBERS_FILE,
    PRACTICE_FOLDER,
    RESULT_FILE,
    RunName,
    parse_folder_name,
    run_folder_names,
)
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.unfinished_runs import find_unfinished
from madrob_console.common.errors import MadrobError
from madrob_console.engine.ipc.engine_interface import UnsureError
from madrob_console.engine.requests import NextRunNumber, OpenRun, Perform
from madrob_console.engine.snapshot import Snapshot
from madrob_console.referee.acts import (
    Abort,
    Act,
    AddNote,
    ConfirmPose,
    Correct,
    DeclareTimeout,
    Finalise,
    Reissue,
    SetUp,
    Start,
    TakeBack,
    Void,
    ZeroHandle,
)
from madrob_console.referee.acts.correct import last_decision
from madrob_console.referee.checks import blocking
from madrob_console.referee.journal import Entry, read_journal
from madrob_console.referee.rebuild import Change, act_of
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run import Phase
from scoring.protocol import Condition
from tests.madrob_console.engine.drive import make_setup, signed
from tests.madrob_console.engine_process import (
    BY_HAND,
    ZERO_NEEDS,
    EngineProcess,
    journal_of,
    result_of,
)
from tests.watching import until

DONE, NO_ANSWER = "done", "no answer"
TRIES = 6
ON_ITS_WAY = 0.5
"""What takes effect at once may be lost with an engine that is killed so soon after it, s."""
_BETWEEN_TRIES = 0.2
_BETWEEN_LOOKS = 0.02
_SUBJECT, _CONDITION = 3, 1  # those of `make_setup`
_BAG_FAILED = "recording to the bag failed"
_OTHER_WAY = Condition.from_number(11)  # from the other side
_NOT_OF_THE_BAG = (
    *("closure", "issue", "notes", "outcome", "outcome_reason", "rulings", "stop"),
    *("voided", "corrections", "taken_back", "setup"),
)


class EngineGoneError(Exception):
    """The engine ended while the referee was at work."""


@dataclass(frozen=True, slots=True)
class Asked:
    """An act that was asked for.

    Attributes:
        act: unlike any other of its run, but for a start.
        run_number: of which run.
        answer: `DONE`, `NO_ANSWER`, or why it was refused.
        took: how long the answer took, s.
        answered_at: when it came, s of the monotonic clock.
    """

    act: Act
    run_number: int
    answer: str
    took: float
    answered_at: float

    def lines(self, ended: float) -> tuple[int, int]:
        """How often it may stand in the journal, at least and at most.

        Args:
            ended: when the engine was ended by force, s of the monotonic clock.
        """
        if self.answer not in (DONE, NO_ANSWER):
            return 0, 0
        on_its_way = self.act.at_once and ended - self.answered_at < ON_ITS_WAY
        return int(self.answer == DONE and not on_its_way), 1


@dataclass
class Notes:
    """What was asked, in order, and the words that were shown: faults and refusals."""

    asked: list[Asked] = field(default_factory=list)
    words: set[str] = field(default_factory=set)

    def slowest(self, *kinds: type[Act]) -> float:
        """The longest that an answer to such an act took, s."""
        return max((one.took for one in self.asked if isinstance(one.act, kinds)), default=0.0)


class Referee:
    """Leads one run with note, result, finalise, re-issue, and insists on each.

    Whatever it does raises `EngineGoneError` when the engine has ended.

    Args:
        engine: of the simulated testbed, whose robot touches the door and gives up.
        patience: for each step, s.
        disk_back: waits until the disk answers again.
    """

    def __init__(
        self,
        engine: EngineProcess,
        patience: float = 30.0,
        disk_back: Callable[[], None] = lambda: None,
    ) -> None:
        self.notes = Notes()
        self._engine = engine
        self._patience = patience
        self._disk_back = disk_back
        self._number = 0

    def sign(self, word: TeamWord, note: str) -> None:
        """Finalise, as soon as it is possible."""
        self.insist(lambda n: signed(self.snapshot(), word, f"{note}, {n}"))

    def whole_run(self) -> None:
        """From the set-up to the second issue."""
        self.start()
        self.insist(lambda n: AddNote(f"in the run, {n}"))
        self.until(lambda s: s.result is not None)
        self.sign(TeamWord.ACKNOWLEDGED, "first")
        self.insist(lambda n: Reissue(f"the protest, {n}"))
        self.insist(lambda n: AddNote(f"after it, {n}"))
        self.insist(lambda n: Void(f"unsafe, {n}"))
        self.until(lambda s: Finalise.name not in s.refusals)
        self.insist(lambda n: Correct(_SUBJECT, _OTHER_WAY, f"typed wrongly, {n}"))
        self.take_back()
        self.sign(TeamWord.PROTESTED, "second")
        self.until(lambda s: not any("NOT on disk" in f or "journal" in f for f in s.faults))

    def start(self, **setup: float) -> None:
        """Set up, prepare and start; a start that is refused has used its number.

        Args:
            setup: of the run, as for `make_setup`.
        """
        for _ in self._tries("start"):
            self.prepare(**setup)
            if self.do(Start()) is None:
                self.until(lambda s: s.run.phase not in (Phase.READY, Phase.COUNTDOWN))
                return
            self._disk_back()
            self.stays_ready()

    def prepare(self, timeout: float = 4.0, countdown: float = 1.0) -> None:
        """All that comes before the start, with a run number that was never used."""
        self._number = self._ask_number()
        setup = make_setup(run_number=self._number, timeout=timeout, countdown=countdown)
        self.do(SetUp(setup))
        self.until(lambda s: all(c.name in BY_HAND for c in blocking(s.checks)))
        self.do(ConfirmPose())
        fresh = self.snapshot().time
        self.until(lambda s: s.time > fresh + ZERO_NEEDS)
        self.insist(lambda _: ZeroHandle())  # on a busy machine the force may be old
        self.until(lambda s: not blocking(s.checks))

    def stays_ready(self, duration: float = _BETWEEN_TRIES) -> None:
        """What was refused is not done later."""
        end = time.monotonic() + duration
        while time.monotonic() < end:
            phase = self.snapshot().run.phase
            assert phase is Phase.READY, f"a start that was refused took effect: {phase}"
            time.sleep(_BETWEEN_LOOKS)

    def insist(self, act: Callable[[int], Act]) -> None:
        """Do an act as soon as it is possible; where it is refused, again, as one of its own."""
        name = act(0).name
        for number in self._tries(name):
            self.until(lambda s: name not in s.refusals)
            if self.do(act(number)) is None:
                return

    def take_back(self) -> None:
        """Take back the last decision, and no other where it is not known whether that was done."""
        last = last_decision(self.snapshot().run)
        for number in self._tries("take back"):
            if last is None or last_decision(self.snapshot().run) != last:
                return
            if self.do(TakeBack(last.kind, last.time, f"my mistake, {number}")) is None:
                return

    def do(self, act: Act) -> str | None:
        """Ask for an act; why it was refused."""
        began = time.monotonic()
        refused, error = None, None
        try:
            refused = self._engine.client.send_request(Perform.of(act))
        except MadrobError as broken:
            refused, error = str(broken), broken
        now = time.monotonic()
        gone = error is not None and self._gone()
        answer = DONE if refused is None else refused
        if gone or isinstance(error, UnsureError):
            answer = NO_ANSWER
        self.notes.asked.append(Asked(act, self._number, answer, now - began, now))
        if gone:
            raise EngineGoneError from error
        if refused is not None:
            self._hear(f"{act.name}: {refused}")
        return refused

    def _tries(self, what: str) -> Iterator[int]:
        """The numbers of the tries; between them the disk comes back."""
        for number in range(TRIES):
            yield number
            self._disk_back()
            time.sleep(_BETWEEN_TRIES)
        raise AssertionError(f"{what} refused {TRIES} times: {self.notes.words}")

    def _ask_number(self) -> int:
        for _ in self._tries("next run number"):
            try:
                return self._engine.client.send_request(
                    NextRunNumber(_SUBJECT, _CONDITION, practice=True)
                )
            except MadrobError as error:
                if self._gone():
                    raise EngineGoneError from error
                self._hear(f"next run number: {error}")
        raise AssertionError

    def _hear(self, words: str) -> None:
        self.notes.words.add(words.replace(str(self._engine.results), "RESULTS"))

    def snapshot(self) -> Snapshot:
        """What a screen would show now."""
        try:
            snapshot = self._engine.snapshot()
        except MadrobError as error:
            if self._gone():
                raise EngineGoneError from error
            raise
        for fault in snapshot.faults:
            if not fault.startswith("/"):  # a topic that is silent on a busy machine
                self._hear(fault)
        return snapshot

    def until(self, done: Callable[[Snapshot], bool]) -> float:
        """Wait until a snapshot is such; how long that took, s."""
        began = time.monotonic()
        while not done(snapshot := self.snapshot()):
            seen = (snapshot.run.phase, snapshot.faults, snapshot.log[-3:])
            assert time.monotonic() < began + self._patience, f"waited in vain: {seen}"
            time.sleep(_BETWEEN_LOOKS)
        return time.monotonic() - began

    def _gone(self, patience: float = 2.0) -> bool:
        """Whether the connection broke because the engine ended."""
        with suppress(MadrobError):
            self._engine.snapshot()
            return False
        with suppress(Exception):
            self._engine.process.wait(patience)
        return self._engine.process.poll() is not None


def what_is_wrong(
    results: Path, notes: Notes, later: EngineProcess, ended: float = math.inf
) -> list[str]:
    """What the next engine finds and the files say, against what was answered; empty = all is well.

    Args:
        results: the results folder.
        notes: of the referee before.
        later: an engine that was started after the other had ended; runs that it reports as cut
            off are closed.
        ended: when the engine before was ended by force, s of the monotonic clock.
    """
    wrong = list(_numbers_used_twice(results))
    wrong += _not_closed(later)
    wrong += _not_as_answered(results, notes, ended)
    for name in sorted(run_folder_names(results)):
        wrong += _not_agreeing(results / name)
    number = later.client.send_request(NextRunNumber(_SUBJECT, _CONDITION, practice=True))
    named = (*_folders(results), *_given_out(results))  # a correction has one of another series
    series = (_SUBJECT, _CONDITION)
    if number <= max((n.run for n in named if (n.subject, n.condition) == series), default=0):
        wrong.append(f"run number {number} would be used twice")
    return wrong


def _not_closed(engine: EngineProcess) -> Iterator[str]:
    """Each run that was cut off can be opened, scored and finalised."""
    cut_off = {run.folder for run in find_unfinished(engine.results)}
    until(lambda: cut_off <= {run.folder for run in engine.snapshot().unfinished})
    for run in engine.snapshot().unfinished:
        try:
            refused = engine.client.send_request(OpenRun(run.folder, invalid=run.started is None))
            if refused is None:
                engine.wait_for(lambda s: s.result is not None and Finalise.name not in s.refusals)
                final = signed(engine.snapshot(), TeamWord.ABSENT, "closed later")
                refused = engine.client.send_request(Perform.of(final))
        except (MadrobError, AssertionError) as error:
            refused = str(error)
        if refused is not None:
            yield f"{run.folder} was cut off and cannot be closed: {refused}"
    if left := engine.snapshot().unfinished:
        yield f"still asked about: {[run.folder for run in left]}"


def _not_as_answered(results: Path, notes: Notes, ended: float) -> Iterator[str]:
    """Each act stands in the journal as often as it was done, by the answers."""
    kept = (AddNote, Abort, DeclareTimeout, Start, Finalise, Reissue, Void, TakeBack)
    asked_for: dict[tuple[Act, int], list[Asked]] = {}
    for asked in notes.asked:
        if isinstance(asked.act, kept):
            asked_for.setdefault((asked.act, asked.run_number), []).append(asked)
    for (act, run_number), asked_often in asked_for.items():
        entries = _journal(results, run_number)
        count = sum(act_of(e) == act for e in entries)
        effective = min(count, _begun(entries)) if isinstance(act, Start) else count
        least, most = map(sum, zip(*(one.lines(ended) for one in asked_often), strict=True))
        if count < least or effective > most:
            answers = [one.answer for one in asked_often]
            yield f"{act}: {answers}, and stands {count} times in the journal"


def _begun(entries: Sequence[Entry]) -> int:
    """How many starts took effect: the countdown has a line of its own, if the start has an id."""
    begun = [entry.what for entry in entries if entry.what == Change.COUNTDOWN_BEGINS]
    return len(begun) + sum(entry.what == Start.name and not entry.id for entry in entries)


def _journal(results: Path, run_number: int) -> tuple[Entry, ...]:
    """What counts in the journal of a run; nothing where there is none."""
    for name in run_folder_names(results):
        if _run_of(name).run == run_number:
            with suppress(OSError):
                return read_journal(results / name / JOURNAL_FILE)[0]
    return ()


def _not_agreeing(folder: Path, patience: float = 40.0) -> Iterator[str]:
    """The result is what journal and bag say, as soon as an engine had the time to look."""
    ran = any(entry.what == Change.RUN_STARTS for entry in journal_of(folder))
    end, differing = time.monotonic() + patience, ["there is no result"] if ran else []
    while (folder / RESULT_FILE).exists():
        try:
            differing = _differing(folder)
        except MadrobError as error:
            differing = [str(error)]
        if not differing or time.monotonic() > end:
            break
        time.sleep(_BETWEEN_TRIES)
    yield from (f"{folder.name}: {words}" for words in differing)


def _differing(folder: Path) -> list[str]:
    """What differs from journal and bag; a bag that broke off has less than the result."""
    torn = any(_BAG_FAILED in remark for remark in result_of(folder)["quality"]["remarks"])
    return [
        difference.words
        for difference in check_run(RunPath(folder)).differences
        if not torn or difference.what.partition(".")[0].partition("[")[0] in _NOT_OF_THE_BAG
    ]


def _numbers_used_twice(results: Path) -> Iterator[str]:
    """Each run number was given out once, and each folder's was given out."""
    given_out, folders = _given_out(results), _folders(results)
    if len(set(given_out)) < len(given_out):
        yield f"a number was given out twice: {given_out}"
    if len(set(folders)) < len(folders):
        yield f"two folders of one number: {folders}"
    if missing := set(folders) - set(given_out):
        yield f"never given out: {missing}"


def _given_out(results: Path) -> list[RunName]:
    found = []
    with suppress(FileNotFoundError):
        for line in (results / PRACTICE_FOLDER / NUMBERS_FILE).read_bytes().splitlines():
            with suppress(msgspec.DecodeError):  # torn
                found.append(msgspec.json.decode(line, type=RunName))
    return found


def _folders(results: Path) -> list[RunName]:
    with suppress(MadrobError):
        return [_run_of(name) for name in run_folder_names(results)]
    return []


def _run_of(name: str) -> RunName:
    parsed = parse_folder_name(name)
    assert parsed is not None
    return parsed[0]
