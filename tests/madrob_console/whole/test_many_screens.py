"""Nothing that other screens do takes the abort away, and a silent engine is called so."""

from __future__ import annotations

import os
import resource
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import pytest

from madrob_console.common.errors import MadrobError
from madrob_console.engine.ipc.client import RemoteEngine
from madrob_console.engine.ipc.engine_interface import UnsureError, awaited
from madrob_console.engine.ipc.server import FOR_REFEREES, MOST_SCREENS
from madrob_console.engine.requests import NO_ANSWER, NextRunNumber, Perform, Role
from madrob_console.referee.acts import Abort, Act, AddNote, DeclareTimeout
from madrob_console.referee.run import Phase
from madrob_console.ui.link import EngineLink
from scoring.protocol import Outcome
from tests.madrob_console.crowd import crowd
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine_process import NO_REPORTS, EngineProcess
from tests.watching import Stutter, stop_process, until

AT_ONCE = 0.2  # s, within which an abort or a declared timeout takes effect
SPECTATORS, FLOOD, FOLDERS = 14, 20_000, 3_000
MORE_MEMORY = 10e6  # bytes, for all screens


def memory_of(engine: EngineProcess) -> float:
    """What its process has in memory, bytes."""
    pages = Path(f"/proc/{engine.process.pid}/statm").read_text().split()[1]
    return float(pages) * os.sysconf("SC_PAGE_SIZE")


def took(engine: EngineProcess, act: Act) -> float:
    """How long it takes until an act has taken effect and is shown, s."""
    began = time.monotonic()
    engine.act(act)
    return time.monotonic() - began


@contextmanager
def held(engine: EngineProcess) -> Iterator[None]:
    """Its process stands still while inside."""
    stop_process(engine.process.pid)
    try:
        yield
    finally:
        engine.process.send_signal(signal.SIGCONT)


@pytest.mark.slow
def test_spectators_a_flood_and_deaf_screens_take_no_act_away(tmp_path: Path) -> None:
    results = tmp_path / "runs"
    for number in range(FOLDERS):  # a listing of them takes its time
        subject, run = divmod(number, 999)
        name = f"subject_{100 + subject:03d}_cond_001_run_{run + 1:03d}_20231114_221320"
        (results / name).mkdir(parents=True)
    acts = {Abort("unsafe"): Outcome.ABORTED, DeclareTimeout("given up"): Outcome.TIMEOUT}
    with EngineProcess(results, "no-touch", settings=NO_REPORTS) as engine:
        for number, (act, outcome) in enumerate(acts.items(), start=1):
            engine.start(make_setup(run_number=number, countdown=1.0, timeout=600.0))
            before = memory_of(engine)
            with crowd(engine.stem, SPECTATORS, FLOOD, deaf=3), Stutter() as stutter:
                for note in range(10):
                    engine.act(AddNote(f"note {note}"))
                end = took(engine, act)
                more = memory_of(engine) - before
                shown = engine.wait_for(lambda s: s.run.phase is Phase.STOPPED)
            print(f"\n{act.name} after {end:.3f} s, {more / 1e6:+.0f} MB")
            assert (shown.run.outcome, shown.recorder.dropped) == (outcome, 0)
            assert end <= AT_ONCE + stutter.allowance
            assert more < MORE_MEMORY
            engine.wait_for(lambda s: s.result is not None)


@pytest.mark.slow
def test_what_is_asked_of_an_engine_that_stands_still_never_happens(tmp_path: Path) -> None:
    """And its screens say within two seconds that it is silent."""
    with EngineProcess(tmp_path / "runs", "no-touch") as engine:
        link = EngineLink(lambda _: engine.client, time.monotonic)
        link.connect()
        engine.start(make_setup(countdown=1.0, timeout=600.0))

        def words() -> str:
            snapshot = link.snapshot()
            assert snapshot is not None
            return snapshot.pulse.words or ""

        assert words() == ""
        with held(engine), Stutter() as stutter:
            began = time.monotonic()
            until(lambda: words().startswith("the engine is silent for 1 s"))
            assert time.monotonic() - began < 2.0 + stutter.allowance
            sent = engine.client.begin_request(Perform.of(Abort("held")))
            until(sent.running)
            filling = [
                engine.client.begin_request(Perform.of(AddNote(50_000 * "x"))) for _ in range(40)
            ]
            begun: list[int] = []

            def no_more_fits() -> bool:
                begun.append(sum(answer.running() for answer in filling))
                return 0 < begun[-1] == begun[-100:][0] and len(begun) > 100

            until(no_more_fits)
            waiting = filling[-1]  # the socket is full: it waits in the screen
            assert not waiting.running()
            assert waiting.cancel()
            with pytest.raises(MadrobError, match=NO_ANSWER):
                engine.client.send_request(Perform.of(Abort("behind those that wait")))
            with pytest.raises(UnsureError):
                awaited(sent, 0.0)
            until(lambda: words().startswith("the engine is silent for "))
        engine.client.send_request(NextRunNumber(3, 1))
        until(lambda: words() == "")
        assert engine.snapshot().run.phase is Phase.RUNNING
        assert engine.snapshot().run.notes == ()
        answers = [answer.exception(30.0) for answer in (sent, *filling[:-1])]
        assert {str(error) for error in answers} == {NO_ANSWER}
        assert took(engine, Abort("now")) < 5.0


IN_VAIN = 12
"""Screens that try once more: each is told at once."""

NONE_LEFT = 3
"""A limit below all that are open: whatever is closed meanwhile makes no room for another."""


def test_twenty_screens_attach_and_four_places_are_for_who_may_act(tmp_path: Path) -> None:
    with EngineProcess(tmp_path / "runs", "nominal") as engine, ExitStack() as stack:
        engine.start(make_setup(timeout=60.0))
        shown: list[RemoteEngine] = []
        for role, most in (
            (Role.WATCH, MOST_SCREENS - FOR_REFEREES),
            (Role.REFEREE, MOST_SCREENS),
        ):
            while len(shown) < most - 1:  # one is that of the test
                shown.append(RemoteEngine(engine.stem, role, "a screen"))
                stack.callback(shown[-1].close)
            for _ in range(IN_VAIN):
                with pytest.raises(MadrobError, match=f"{most} screens are attached, the most"):
                    RemoteEngine(engine.stem, role, "one too many")
        engine.act(Abort("enough"))
        until(lambda: {one.snapshot().run.phase for one in shown} == {Phase.STOPPED})
        assert engine.result()["outcome"] == "aborted"
        assert engine.log.read_text() == ""


def test_without_file_handles_screens_wait_and_the_log_says_it_once(tmp_path: Path) -> None:
    with EngineProcess(tmp_path / "runs", "nominal") as engine:

        def processor_time() -> float:
            stat = Path(f"/proc/{engine.process.pid}/stat").read_text().rpartition(")")[2].split()
            return (int(stat[11]) + int(stat[12])) / os.sysconf("SC_CLK_TCK")

        limits = resource.prlimit(engine.process.pid, resource.RLIMIT_NOFILE)
        resource.prlimit(engine.process.pid, resource.RLIMIT_NOFILE, (NONE_LEFT, limits[1]))
        before, begin = processor_time(), time.monotonic()
        with pytest.raises(TimeoutError):
            RemoteEngine(engine.stem, Role.WATCH, "a watcher")
        assert processor_time() - before < 0.5 * (time.monotonic() - begin)
        assert engine.snapshot().run.phase is Phase.IDLE
        said = engine.log.read_text()
        assert said.count("new screens must wait ([Errno 24] Too many open files)\n") == 1
        assert "socket.accept" not in said
        resource.prlimit(engine.process.pid, resource.RLIMIT_NOFILE, limits)
        with closing(RemoteEngine(engine.stem, Role.WATCH, "a watcher")) as watcher:
            assert until(lambda: watcher.snapshot().run.phase is Phase.IDLE)
