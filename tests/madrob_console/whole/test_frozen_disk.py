"""A disk that does not answer takes nothing from the referee: real processes, a frozen file system.

Its own ioctl freezes it: each call that would change it waits until it is thawed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import product
from pathlib import Path

import pytest

from madrob_console.messages.codec import REFEREE_STATE_TOPIC, decode_text
from madrob_console.messages.message_types import MessageTypes
from madrob_console.referee.acts import Abort, AddNote, DeclareTimeout, Finalise, Reissue, Start
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run import Phase
from recorder.reader import read_bag
from scoring.protocol import POST_ROLL, Outcome
from scoring.result import Result
from tests.madrob_console.console_process import ENTER, F5, F6, F7, F8, Hall, start_a_run
from tests.madrob_console.engine.drive import signed
from tests.madrob_console.engine_process import ROOT, STARTING, EngineProcess
from tests.madrob_console.fault_table import Row, fault_table
from tests.madrob_console.refereed_run import Referee, what_is_wrong
from tests.madrob_console.ros_peer import Peer
from tests.madrob_console.small_disk import SmallDisk, disk_image
from tests.madrob_console.warm_starts import WarmStarts
from tests.terminal import Terminal
from tests.watching import until

ALL_FROM = 300
"""`--runs` from which every moment and length is tried."""
MOMENTS = 10
LENGTHS = (5.0, 20.0, 60.0)  # s
AT_A_TIME = 6
AT_ONCE = 0.2  # s, within which an abort or a declared timeout takes effect
SHOWN = 0.5  # s, within which a screen has it, on a machine that is busy with this
ON_TIME = 0.5  # s, within which a stop that the clock decides is shown
DURABLE = 2.0  # s, after which an act that is not on disk is withdrawn
ANSWERED = DURABLE + 0.5
RESULT_AFTER = 5.0  # s from the thaw to the result
SETTLE = 1.0  # s that a closed door is watched
FROZEN_FOR = 1.0  # s that the disk has been silent when the referee acts
_NO_REPORTS = "[results]\nreports = false\n"
_TYPES = MessageTypes()


class Matter(StrEnum):
    """What is about to happen while the disk is frozen."""

    ABORT = "abort"
    DECLARED = "timeout declared"
    ELAPSED = "timeout elapsed"
    COMPLETED = "completed"
    START = "start"
    FINALISE = "finalise"


@dataclass(frozen=True, slots=True)
class Case:
    """One of the runs.

    Attributes:
        matter: what happens.
        moment: of ten, when the disk freezes.
        length: for how long, s.
    """

    matter: Matter
    moment: int
    length: float

    def __str__(self) -> str:
        return f"{self.matter}, moment {self.moment}, frozen for {self.length:g} s"


@dataclass
class Seen:
    """What came of it.

    Attributes:
        delays: s by what they are the delay of.
        wrong: what was not as it must be.
        words: that a screen got.
    """

    delays: dict[str, float] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)
    words: set[str] = field(default_factory=set)

    def expect(self, holds: bool, words: str) -> None:
        """Note what does not hold."""
        if not holds:
            self.wrong.append(words)


class Frozen:
    """The disk of a run, frozen for a while.

    Args:
        disk: of the results.
        length: how long it is frozen, s.

    Attributes:
        since: when it was frozen, s since the epoch.
        until: when it was thawed.
    """

    def __init__(self, disk: SmallDisk, length: float) -> None:
        self.since = self.until = 0.0
        self._disk = disk
        self._length = length
        self._is = threading.Event()
        self._thread = threading.Thread(target=self._stay)

    def begin(self, after: float = 0.0) -> None:
        """Freeze it in so many seconds; returns at once."""
        self._after = after
        self._thread.start()

    def _stay(self) -> None:
        time.sleep(self._after)
        with self._disk.stalled():
            self.since = time.time()
            self._is.set()
            time.sleep(self._length)
        self.until = time.time()

    def wait_frozen(self) -> None:
        """Until it is."""
        assert self._is.wait(30.0)

    def wait_thawed(self) -> None:
        """Until it answers again."""
        if self._thread.ident is not None:
            self._thread.join()


@contextmanager
def engine_on(
    disk: SmallDisk, warm: WarmStarts, scenario: str = "touch-only"
) -> Iterator[EngineProcess]:
    results = disk.folder / "results"
    with EngineProcess(results, scenario, warm=warm, settings=_NO_REPORTS) as process:
        yield process


def go_through(case: Case, folder: Path, warm: WarmStarts) -> Seen:
    """One run."""
    folder.mkdir()
    seen = Seen()
    scenario = "nominal" if case.matter is Matter.COMPLETED else "touch-only"
    with disk_image(folder / "disk") as disk:
        frozen = Frozen(disk, case.length)
        results = disk.folder / "results"
        try:
            with engine_on(disk, warm, scenario) as process:
                referee = Referee(
                    process, patience=case.length + 40.0, disk_back=frozen.wait_thawed
                )
                try:
                    _HOW[case.matter](case, referee, frozen, seen)
                except AssertionError as error:
                    seen.wrong.append(str(error))
                finally:
                    frozen.wait_thawed()
                process.end()
                seen.expect("Traceback" not in (log := process.log.read_text()), log[-2000:])
        finally:
            frozen.wait_thawed()
        with engine_on(disk, warm) as later:
            seen.wrong += what_is_wrong(results, referee.notes, later)
        announced(case, results, referee, seen)
    seen.words |= referee.notes.words
    return seen


def stopped_by_referee(case: Case, referee: Referee, frozen: Frozen, seen: Seen) -> None:
    """Abort or declared timeout, pressed while the disk has been silent for a second."""
    referee.start(timeout=200.0)
    frozen.begin(0.3 * case.moment)
    frozen.wait_frozen()
    time.sleep(FROZEN_FOR)
    act = Abort("unsafe") if case.matter is Matter.ABORT else DeclareTimeout("stuck")
    outcome = Outcome.ABORTED if case.matter is Matter.ABORT else Outcome.TIMEOUT
    watched = Watched(lambda: referee.snapshot().run.outcome is outcome)
    refused = referee.do(act)
    seen.expect(refused is None, f"{act.name} was refused: {refused}")
    seen.delays["shown"] = watched.took()
    seen.delays["answered"] = referee.notes.slowest(Abort, DeclareTimeout)
    seen.expect(seen.delays["shown"] <= SHOWN, f"shown after {seen.delays['shown']:.2f} s")
    clock_goes_on(referee, seen)
    result_after_thaw(referee, frozen, seen)


def stopped_by_clock(case: Case, referee: Referee, frozen: Frozen, seen: Seen) -> None:
    """The timeout elapses while nothing can be written."""
    timeout = 4.0
    referee.start(timeout=timeout)
    frozen.begin(0.35 * case.moment)
    referee.until(lambda s: s.run.phase is Phase.STOPPED)
    run, late = referee.snapshot().run, time.time()
    assert run.start is not None
    seen.delays["shown"] = late - (run.start + timeout)
    seen.expect(run.outcome is Outcome.TIMEOUT, f"ended as {run.outcome}")
    seen.expect(seen.delays["shown"] <= ON_TIME, f"shown {seen.delays['shown']:.2f} s late")
    result_after_thaw(referee, frozen, seen)


def completed(case: Case, referee: Referee, frozen: Frozen, seen: Seen) -> None:
    """The robot does all that it should."""
    referee.start(timeout=60.0)
    frozen.begin(1.1 * case.moment)
    referee.until(lambda s: s.run.phase is Phase.STOPPED)
    run, late = referee.snapshot().run, time.time()
    assert run.stop is not None
    seen.delays["shown"] = late - run.stop - 1.0  # the settle time
    seen.expect(run.outcome is Outcome.COMPLETED, f"ended as {run.outcome}")
    seen.expect(seen.delays["shown"] <= ON_TIME, f"shown {seen.delays['shown']:.2f} s late")
    result_after_thaw(referee, frozen, seen)


def started(case: Case, referee: Referee, frozen: Frozen, seen: Seen) -> None:
    """A start that is not on disk in time is withdrawn, and never takes effect."""
    referee.prepare()
    pressed(case, frozen)
    refused = referee.do(Start())
    seen.delays["answered"] = referee.notes.slowest(Start)
    seen.expect(
        seen.delays["answered"] <= ANSWERED, f"answered after {seen.delays['answered']:.2f} s"
    )
    if refused is not None:
        referee.stays_ready(max(0.0, frozen.since + case.length - time.time()) + 3.0)
        frozen.wait_thawed()
        referee.start()
    referee.until(lambda s: s.result is not None)
    frozen.wait_thawed()


def finalised(case: Case, referee: Referee, frozen: Frozen, seen: Seen) -> None:
    """A result is final when the disk has it, or it is not."""
    referee.start()
    referee.until(lambda s: s.result is not None)
    pressed(case, frozen)
    refused = referee.do(signed(referee.snapshot(), note="first"))
    seen.delays["answered"] = referee.notes.slowest(Finalise)
    seen.expect(
        seen.delays["answered"] <= ANSWERED, f"answered after {seen.delays['answered']:.2f} s"
    )
    if refused is not None:
        frozen.wait_thawed()
        time.sleep(1.0)
        phase = referee.snapshot().run.phase
        seen.expect(phase is Phase.STOPPED, f"refused, and then {phase}")
        referee.sign(TeamWord.PROTESTED, "second")
    frozen.wait_thawed()
    referee.insist(lambda n: Reissue(f"the protest, {n}"))
    referee.sign(TeamWord.PROTESTED, "third")


_HOW = {
    Matter.ABORT: stopped_by_referee,
    Matter.DECLARED: stopped_by_referee,
    Matter.ELAPSED: stopped_by_clock,
    Matter.COMPLETED: completed,
    Matter.START: started,
    Matter.FINALISE: finalised,
}


def pressed(case: Case, frozen: Frozen) -> None:
    """Wait until it is the moment to press: 1.5 s after the freezing to 2 s before it."""
    before = (1.5, 0.5, 0.1, 0.0)
    if case.moment < len(before):
        frozen.begin()
        frozen.wait_frozen()
        time.sleep(before[case.moment])
        return
    frozen.begin(after=0.002 * 4 ** (case.moment - len(before)))


class Watched:
    """Watches for something from now on, in a thread."""

    def __init__(self, seen: Callable[[], bool], patience: float = 100.0) -> None:
        self._began = time.monotonic()
        self._at: float | None = None
        self._seen = seen
        self._patience = patience
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()

    def _watch(self) -> None:
        while time.monotonic() < self._began + self._patience:
            if self._seen():
                self._at = time.monotonic()
                return
            time.sleep(0.005)

    def took(self) -> float:
        """How long it took, s."""
        self._thread.join()
        return self._patience if self._at is None else self._at - self._began


def clock_goes_on(referee: Referee, seen: Seen, lasting: float = 1.0) -> None:
    """While the disk is silent a note is taken and the time goes on."""
    before, began = referee.snapshot().time, time.monotonic()
    refused = referee.do(AddNote("while nothing can be written"))
    seen.expect(refused is None, f"a note was refused: {refused}")
    time.sleep(lasting)
    lag = (time.monotonic() - began) - (referee.snapshot().time - before)
    seen.delays["clock"] = lag
    seen.expect(lag <= SHOWN, f"the clock lags by {lag:.2f} s")


def result_after_thaw(referee: Referee, frozen: Frozen, seen: Seen) -> None:
    """The result comes as soon as the disk is back, and says nothing of it."""
    frozen.wait_thawed()
    referee.until(lambda s: s.result is not None)
    referee.until(lambda s: not s.faults)
    took, stop = time.time() - frozen.until, referee.snapshot().run.stop
    assert stop is not None
    decided = stop + (SETTLE if result_of(referee).outcome is Outcome.COMPLETED else 0.0)
    took = min(took, time.time() - decided - POST_ROLL)
    seen.delays["result"] = took
    seen.expect(took <= RESULT_AFTER, f"the result came {took:.2f} s after the thaw")
    remarks = result_of(referee).quality.remarks
    seen.expect(remarks == (), f"remarks: {remarks}")


def result_of(referee: Referee) -> Result:
    """As a screen shows it."""
    result = referee.snapshot().result
    assert result is not None
    return result


def announced(case: Case, results: Path, referee: Referee, seen: Seen) -> None:
    """How long after the key the topic told robot and testbed of an abort: the bag has its time."""
    if case.matter not in (Matter.ABORT, Matter.DECLARED):
        return
    (folder,) = results.glob("practice/subject_*")
    pressed_at = next(
        a.at for a in referee.notes.asked if isinstance(a.act, Abort | DeclareTimeout)
    )
    said = [
        message.receive_ns / 1e9
        for message in read_bag(folder).messages()
        if message.topic == REFEREE_STATE_TOPIC
        and json.loads(decode_text(_TYPES, message.data))["phase"] == Phase.STOPPED
    ]
    seen.expect(len(said) == 1, f"announced {len(said)} times")
    if said:
        seen.delays["announced"] = said[0] - pressed_at
        late = seen.delays["announced"]
        seen.expect(late <= AT_ONCE, f"announced after {late:.2f} s")


@pytest.fixture(scope="module")
def warm() -> Iterator[WarmStarts]:
    with WarmStarts() as starts:
        yield starts


@pytest.mark.needs("mkfs.ext4")
@pytest.mark.slow
def test_a_frozen_disk_takes_no_act_from_the_referee(
    warm: WarmStarts, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    whole = request.config.getoption("--runs") >= ALL_FROM
    moments = range(MOMENTS) if whole else (3,)
    lengths = LENGTHS if whole else LENGTHS[:1]
    cases = [Case(*case) for case in product(Matter, moments, lengths)]
    with ThreadPoolExecutor(AT_A_TIME) as pool:
        done = [
            pool.submit(go_through, case, tmp_path / str(n), warm) for n, case in enumerate(cases)
        ]
        all_seen = [one.result() for one in done]
    rows = {matter: Row(f"{matter}, disk frozen") for matter in Matter}
    for case, seen in zip(cases, all_seen, strict=True):
        rows[case.matter].add(str(case), seen.delays, seen.wrong, seen.words)
    print(fault_table(list(rows.values())))
    assert not [one for row in rows.values() for one in row.lost]


ON_SCREEN = 1.5  # s, from the key to the screen, drawn by a busy machine
STAYS = 2.0  # s, in which the words are looked at again and again
SILENT = "disk silent for"


@contextmanager
def hall_on(disk: SmallDisk) -> Iterator[Hall]:
    with Hall(speed=1.0) as hall:
        hall.results = disk.folder / "runs"
        settings = hall.folder / "madrob.toml"
        settings.write_text("[results]\nreports = false\n[checks]\ndisk_space = 0\n")
        yield hall


def key_pressed(terminal: Terminal, keys: str, *texts: str) -> float:
    """How long it takes from keys to what they bring, s."""
    began = time.monotonic()
    terminal.send(keys)
    terminal.wait_for(*texts)
    return time.monotonic() - began


@pytest.mark.slow
@pytest.mark.needs("mkfs.ext4")
def test_a_screen_says_that_the_disk_is_silent_and_abort_works(tmp_path: Path) -> None:
    with (
        disk_image(tmp_path / "disk") as disk,
        hall_on(disk) as hall,
        hall.console(columns=120, lines=40) as terminal,
    ):
        start_a_run(terminal)
        folder = hall.wait_for_running()
        with disk.stalled():
            terminal.wait_for(SILENT, timeout=5.0)
            terminal.send(F8)
            terminal.wait_for("ABORT the run")
            terminal.send("1")
            took = key_pressed(terminal, "y", "ABORTED")
            terminal.wait_for("NOT ON DISK YET", timeout=5.0)
            stays = time.monotonic() + STAYS
            while time.monotonic() < stays:
                terminal.wait_for("NOT ON DISK YET", timeout=0.1)
                terminal.wait_for(SILENT, timeout=0.1)
            shown = terminal.screen()
        assert hall.wait_for_result(folder)["outcome"] == "aborted"
        terminal.wait_for("counts nowhere: x is the next run")
        late = (SILENT, "NOT ON DISK")
        until(lambda: not any(word in line for line in terminal.screen() for word in late))
    print(f"\naborted on the screen {1000 * took:.0f} ms after the key, the disk being frozen:")
    print("\n".join(line for line in shown if SILENT in line or "NOT ON DISK" in line))
    assert took <= ON_SCREEN


@pytest.mark.slow
@pytest.mark.needs("mkfs.ext4")
def test_a_start_that_the_disk_holds_up_is_refused_on_the_screen_and_never_comes(
    tmp_path: Path,
) -> None:
    with (
        disk_image(tmp_path / "disk") as disk,
        hall_on(disk) as hall,
        hall.console(columns=120, lines=40) as terminal,
    ):
        terminal.wait_for("2 of 9 in the way", timeout=STARTING)
        terminal.send(ENTER)
        terminal.wait_for("is set up", timeout=STARTING)
        terminal.send(F7)
        terminal.wait_for("Done: zero the handle", timeout=STARTING)
        terminal.send(F6)
        terminal.wait_for("all passed or waived", timeout=STARTING)
        with disk.stalled():
            took = key_pressed(terminal, F5, "Refused: start")
            shown = [line for line in terminal.screen() if "Refused: start" in line]
            time.sleep(3.0)
        time.sleep(3.0)  # in which it could come late
        assert not any(
            word in line for word in ("COUNTDOWN", "RUNNING") for line in terminal.screen()
        )
    print(f"\nrefused after {1000 * took:.0f} ms: {shown}")
    assert 1.5 <= took <= 3.5


@pytest.mark.slow
@pytest.mark.needs("mkfs.ext4")
def test_an_abort_is_on_dds_at_once_while_the_disk_is_frozen(
    ros_domain: int, tmp_path: Path
) -> None:
    testbed = subprocess.Popen(
        [sys.executable, "-m", "madrob_console.cli.main", "testbed", "--scenario", "touch-only"],
        cwd=ROOT,
        env=os.environ,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        with (
            disk_image(tmp_path / "disk") as disk,
            EngineProcess(disk.folder / "results", None) as engine,
            Peer(ros_domain) as peer,
        ):
            heard = peer.listen_raw(REFEREE_STATE_TOPIC, "std_msgs/msg/String")
            referee = Referee(engine, patience=STARTING)
            referee.start(timeout=60.0)
            peer.until(lambda: "running" in phases(heard))
            with disk.stalled():
                time.sleep(1.0)
                pressing = threading.Thread(target=lambda: referee.do(Abort("unsafe")))
                began = time.monotonic()
                pressing.start()
                peer.until(lambda: "stopped" in phases(heard))
                took = time.monotonic() - began
                pressing.join()
            referee.until(lambda s: s.result is not None)
            result = referee.snapshot().result
            assert result is not None
            assert result.outcome is Outcome.ABORTED
    finally:
        testbed.terminate()
        testbed.wait()
    print(f"\nan abort was on {REFEREE_STATE_TOPIC} after {1000 * took:.0f} ms")
    assert took <= AT_ONCE


def phases(heard: list[bytes]) -> list[str]:
    """The phases that were announced."""
    return [json.loads(decode_text(_TYPES, data))["phase"] for data in heard]
