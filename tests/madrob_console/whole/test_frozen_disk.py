"""A disk that does not answer takes nothing from the referee: real processes, a frozen file system.

Its own ioctl freezes it: each call that would change it waits until it is thawed."""

from __future__ import annotations

import json
import threading
import time
from collections import defaultdict
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from types import MappingProxyType

import pytest

from madrob_console.messages.codec import REFEREE_STATE_TOPIC, decode_text
from madrob_console.referee.acts import Abort, AddNote, Start
from madrob_console.referee.run import Phase
from scoring.protocol import POST_ROLL, Outcome
from tests.madrob_console.engine_process import (
    NO_REPORTS,
    STARTING,
    EngineProcess,
    Hall,
    madrob_beside,
    result_of,
)
from tests.madrob_console.refereed_run import Referee, what_is_wrong
from tests.madrob_console.ros_peer import KEPT, TYPES, Peer
from tests.madrob_console.small_disk import SmallDisk, disk_image
from tests.terminal import Terminal
from tests.watching import Stutter, until

ALL_FROM = 300
"""`--runs` from which every moment and length is tried."""
MOMENTS = 10
LENGTHS = (5.0, 20.0, 60.0)  # s
AT_A_TIME = 6
AT_ONCE = 0.2  # s, within which an abort takes effect
SHOWN = 0.5  # s, within which a screen has a stop, on a machine that is busy with this
ANSWERED = 2.5  # s; an act that is not on disk after 2 s is withdrawn
RESULT_AFTER = 10.0  # s from the thaw to the result
SETTLE = 1.0  # s that a closed door is watched
FROZEN_FOR = 1.0  # s that the disk has been silent when the referee acts
LATE = 3.0  # s in which what was refused could still come


class Frozen:
    """A disk that is frozen for a while.

    Args:
        disk: of the results.
        length: how long it is frozen, s.

    Attributes:
        until: when it was thawed, s since the epoch.
    """

    def __init__(self, disk: SmallDisk, length: float) -> None:
        self.until = 0.0
        self._disk, self._length = disk, length
        self._is = threading.Event()
        self._timer = threading.Timer(0.0, self._stay)

    def begin(self, after: float = 0.0) -> None:
        """Freeze it in so many seconds; returns at once."""
        self._timer.interval = after
        self._timer.start()

    def _stay(self) -> None:
        with self._disk.stalled():
            self._is.set()
            time.sleep(self._length)
        self.until = time.time()

    def wait_frozen(self) -> None:
        """Until it is."""
        assert self._is.wait(30.0)

    def wait_thawed(self) -> None:
        """Until it answers again."""
        if self._timer.ident is not None:
            self._timer.join()


@dataclass(frozen=True, slots=True)
class Case:
    """A run whose disk is frozen.

    Attributes:
        referee: leads it.
        frozen: its disk.
        moment: of ten, when the disk freezes.
        delays: s by what they are the delay of.
        stutter: of the machine.
    """

    referee: Referee
    frozen: Frozen
    moment: int
    delays: dict[str, float]
    stutter: Stutter

    def within(self, limit: float, name: str, delay: float) -> None:
        self.delays[name] = delay
        assert delay <= limit + self.stutter.allowance, f"{name} after {delay:.2f} s"

    def start(self) -> str | None:
        """Pressed 1.5 s after the freezing to 2 s before it; why it is refused."""
        before = (1.5, 0.5, 0.1, 0.0)
        frozen = self.moment < len(before)
        if frozen:
            self.frozen.begin()
            self.frozen.wait_frozen()
            time.sleep(before[self.moment])
        else:
            self.frozen.begin(after=0.002 * 4 ** (self.moment - len(before)))
        refused = self.referee.do(Start())
        self.within(ANSWERED, "answered", self.referee.notes.slowest(Start))
        assert refused is not None or not frozen
        return refused

    def result_after_thaw(self) -> None:
        """The result comes as soon as the disk is back, and says nothing of it."""
        self.frozen.wait_thawed()
        self.referee.until(lambda s: s.result is not None)
        self.referee.until(lambda s: not s.faults)
        now, snapshot = time.time(), self.referee.snapshot()
        assert snapshot.run.stop is not None
        assert snapshot.result is not None
        decided = snapshot.run.stop + SETTLE * (snapshot.run.outcome is Outcome.COMPLETED)
        self.within(RESULT_AFTER, "result", min(now - self.frozen.until, now - decided - POST_ROLL))
        assert snapshot.result.quality.remarks == ()

    def abort(self) -> None:
        """Pressed while the disk is silent; a note is taken and the clock goes on."""
        referee = self.referee
        referee.start(timeout=200.0)
        self.frozen.begin(0.3 * self.moment)
        self.frozen.wait_frozen()
        time.sleep(FROZEN_FOR)
        began = time.monotonic()
        assert referee.do(Abort("unsafe")) is None
        referee.until(lambda s: s.run.outcome is Outcome.ABORTED)
        self.within(SHOWN, "abort", time.monotonic() - began)
        before, began = referee.snapshot().time, time.monotonic()
        assert referee.do(AddNote("while nothing can be written")) is None
        time.sleep(1.0)
        passed = referee.snapshot().time - before
        self.within(SHOWN, "clock", (time.monotonic() - began) - passed)
        self.result_after_thaw()

    def stops_by_itself(self, timeout: float, outcome: Outcome) -> None:
        self.referee.start(timeout=timeout)
        self.frozen.begin((0.35 if outcome is Outcome.TIMEOUT else 1.1) * self.moment)
        self.referee.until(lambda s: s.run.phase is Phase.STOPPED)
        run, now = self.referee.snapshot().run, time.time()
        assert (run.outcome, run.stop is not None) == (outcome, True)
        settle = SETTLE * (outcome is Outcome.COMPLETED)
        self.within(SHOWN, f"{outcome}", now - (run.stop or now) - settle)
        self.result_after_thaw()

    def elapsed(self) -> None:
        self.stops_by_itself(4.0, Outcome.TIMEOUT)

    def completed(self) -> None:
        self.stops_by_itself(60.0, Outcome.COMPLETED)

    def started(self) -> None:
        """A start that is not on disk in time is withdrawn, and never takes effect."""
        self.referee.prepare()
        if self.start() is not None:
            self.frozen.wait_thawed()
            self.referee.stays_ready(LATE)
            self.referee.start()
        self.referee.until(lambda s: s.result is not None)


CASES = (Case.abort, Case.elapsed, Case.completed, Case.started)


def go_through(how: int, moment: int, length: float, folder: Path) -> Mapping[str, float]:
    """One run, and what the next engine finds; the delays, s."""
    scenario = "nominal" if CASES[how] == Case.completed else "touch-only"
    with disk_image(folder) as disk, Stutter() as stutter:
        frozen, results = Frozen(disk, length), disk.folder / "results"
        with EngineProcess(results, scenario, settings=NO_REPORTS) as engine:
            referee = Referee(engine, patience=length + 40.0, disk_back=frozen.wait_thawed)
            case = Case(referee, frozen, moment, {}, stutter)
            try:
                CASES[how](case)
            finally:
                frozen.wait_thawed()
            engine.end()
            log = engine.log.read_text()
            assert "Traceback" not in log, log
        with EngineProcess(results, "touch-only", settings=NO_REPORTS) as later:
            assert what_is_wrong(results, referee.notes, later) == []
    return MappingProxyType(case.delays)


@pytest.mark.needs("mkfs.ext4")
@pytest.mark.slow
def test_a_frozen_disk_takes_no_act_from_the_referee(
    request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    whole = request.config.getoption("--runs") >= ALL_FROM
    moments, lengths = (range(MOMENTS), LENGTHS) if whole else ((3,), LENGTHS[:1])
    cases = list(product(range(len(CASES)), moments, lengths))
    with ThreadPoolExecutor(AT_A_TIME) as pool:
        done = [pool.submit(go_through, *case, tmp_path / str(n)) for n, case in enumerate(cases)]
    worst: dict[str, float] = defaultdict(float)
    for one in done:
        for name, delay in one.result().items():
            worst[name] = max(delay, worst[name])
    print(f"\n{len(done)} runs, the worst delays, s:", dict(worst))


SILENT = "disk silent for"
ON_SCREEN = 1.5  # s, from the key to the screen, drawn by a busy machine


def key_pressed(terminal: Terminal, key: str, *texts: str) -> float:
    """How long it takes from a key to what it brings, s."""
    began = time.monotonic()
    terminal.press(key)
    terminal.wait_for(*texts)
    return time.monotonic() - began


@pytest.mark.slow
@pytest.mark.needs("mkfs.ext4")
def test_a_screen_says_that_the_disk_is_silent_aborts_and_refuses_a_start(tmp_path: Path) -> None:
    with (
        disk_image(tmp_path / "disk") as disk,
        Hall(speed=1.0, results=disk.folder / "runs") as hall,
        hall.console(columns=120, lines=40) as terminal,
        Stutter() as stutter,
    ):
        terminal.start_a_run()
        folder = hall.wait_for_running()
        with disk.stalled():
            terminal.wait_for(SILENT)
            terminal.press("F8")
            terminal.wait_for("ABORT the run")
            terminal.send("1")
            assert key_pressed(terminal, "y", "ABORTED") <= ON_SCREEN + stutter.allowance
            terminal.wait_for("NOT ON DISK YET")
            terminal.wait_for(SILENT)
        assert result_of(folder, STARTING)["outcome"] == "aborted"
        until(lambda: not terminal.shows(SILENT, "NOT ON DISK"))
        terminal.make_ready()
        with disk.stalled():
            took = key_pressed(terminal, "F5", "Refused: start")
            assert 1.5 <= took <= ANSWERED + ON_SCREEN + stutter.allowance
        late = time.monotonic() + LATE
        while time.monotonic() < late:
            assert not terminal.shows("COUNTDOWN")
            time.sleep(0.1)


@pytest.mark.slow
@pytest.mark.needs("mkfs.ext4")
def test_an_abort_is_on_dds_at_once_while_the_disk_is_frozen(
    ros_domain: int, tmp_path: Path
) -> None:
    with (
        madrob_beside("testbed", "--scenario=touch-only", output=tmp_path / "testbed"),
        disk_image(tmp_path / "disk") as disk,
        EngineProcess(disk.folder / "results", None) as engine,
        Peer(ros_domain) as peer,
        Stutter() as stutter,
    ):
        heard = peer.listen_raw(REFEREE_STATE_TOPIC, "std_msgs/msg/String", KEPT)

        def announced(phase: str) -> bool:
            return any(json.loads(decode_text(TYPES, data))["phase"] == phase for data in heard)

        referee = Referee(engine, patience=STARTING)
        referee.start(timeout=60.0)
        peer.until(lambda: announced("running"))
        with disk.stalled():
            time.sleep(FROZEN_FOR)
            pressing = threading.Thread(target=lambda: referee.do(Abort("unsafe")))
            began = time.monotonic()
            pressing.start()
            peer.until(lambda: announced("stopped"))
            took = time.monotonic() - began
            pressing.join()
        print(f"\nan abort was on {REFEREE_STATE_TOPIC} after {1000 * took:.0f} ms")
        assert took <= AT_ONCE + stutter.allowance
        assert engine.result()["outcome"] == "aborted"
