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
from madrob_console.engine.client import RemoteEngine
from madrob_console.engine.requests import NO_ANSWER, NextRunNumber, Perform, Role
from madrob_console.engine.server import FOR_REFEREES, MOST_SCREENS
from madrob_console.engine.wire import UnsureError, awaited
from madrob_console.referee.acts import Abort, Act, AddNote, DeclareTimeout
from madrob_console.referee.run import Phase
from madrob_console.ui.link import EngineLink
from scoring.protocol import Outcome
from tests.madrob_console.crowd import crowd
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine_process import EngineProcess
from tests.madrob_console.fault_table import Row, fault_table
from tests.watching import until

AT_ONCE = 0.2  # s, within which an abort or a declared timeout takes effect
SPECTATORS, FLOOD, FOLDERS = 14, 20_000, 3_000
MORE_MEMORY = 10e6  # bytes, for all screens


def many_runs(results: Path) -> None:
    """So many folders of runs that a listing of them takes its time."""
    for number in range(FOLDERS):
        subject, run = divmod(number, 999)
        name = f"subject_{100 + subject:03d}_cond_001_run_{run + 1:03d}_20231114_221320"
        (results / name).mkdir(parents=True)


def memory_of(engine: EngineProcess) -> float:
    """What its process has in memory, bytes."""
    status = Path(f"/proc/{engine.process.pid}/status").read_text()
    (line,) = (line for line in status.splitlines() if line.startswith("VmRSS:"))
    return 1024.0 * int(line.split()[1])


def took(engine: EngineProcess, act: Act) -> float:
    """How long it takes until an act has taken effect and is shown, s."""
    began = time.monotonic()
    refused = engine.client.send_request(Perform.of(act))
    assert refused is None, refused
    return time.monotonic() - began


@contextmanager
def held(engine: EngineProcess) -> Iterator[None]:
    """Its process stands still while inside."""
    engine.process.send_signal(signal.SIGSTOP)
    try:
        yield
    finally:
        engine.process.send_signal(signal.SIGCONT)


@pytest.mark.slow
def test_spectators_a_flood_and_deaf_screens_take_no_act_away(tmp_path: Path) -> None:
    results = tmp_path / "runs"
    many_runs(results)
    more: list[float] = []
    row = Row(f"{SPECTATORS} spectators, {FLOOD:,} requests of one, 3 deaf screens")
    with EngineProcess(results, "no-touch", settings="[results]\nreports = false\n") as engine:
        for number, last in enumerate((Abort("unsafe"), DeclareTimeout("given up")) * 3):
            engine.start(make_setup(run_number=number + 1, countdown=1.0, timeout=600.0))
            before = memory_of(engine)
            with crowd(engine.name, SPECTATORS, FLOOD, deaf=3):
                time.sleep(0.5)
                notes = [took(engine, AddNote(f"note {note}")) for note in range(10)]
                end = took(engine, last)
                more.append(memory_of(engine) - before)
                shown = engine.wait_for(lambda s: s.run.phase is Phase.STOPPED)
            expected = Outcome.ABORTED if isinstance(last, Abort) else Outcome.TIMEOUT
            wrong = [] if shown.run.outcome is expected else [f"{shown.run.outcome}"]
            wrong += [] if shown.recorder.dropped == 0 else ["messages"]
            row.add(str(number), {last.name: end, "note": max(notes)}, wrong, ())
            engine.wait_for(lambda s: s.result is not None)
    print(fault_table([row]), f"\nmemory: {max(more) / 1e6:+.0f} MB at most")
    assert row.lost == []
    assert max(row.delays["abort"], row.delays["declare timeout"]) <= AT_ONCE
    assert max(more) < MORE_MEMORY


@pytest.mark.slow
def test_what_is_asked_of_an_engine_that_stands_still_never_happens(tmp_path: Path) -> None:
    with EngineProcess(tmp_path / "runs", "no-touch") as engine:
        engine.start(make_setup(countdown=1.0, timeout=600.0))
        with held(engine):
            sent = engine.client.begin_request(Perform.of(Abort("held")))
            until(sent.running)
            filling = [
                engine.client.begin_request(Perform.of(AddNote(50_000 * "x"))) for _ in range(40)
            ]
            until(lambda: any(answer.running() for answer in filling))
            waiting = filling[-1]  # the socket is full: it waits in the screen
            time.sleep(0.5)
            assert not waiting.running()
            assert waiting.cancel()
            with pytest.raises(MadrobError, match=NO_ANSWER):
                engine.client.send_request(Perform.of(Abort("behind those that wait")))
            with pytest.raises(UnsureError):
                awaited(sent, 0.0)
        engine.client.send_request(NextRunNumber(3, 1))
        shown = engine.wait_for(lambda s: s.pulse.words is None)
        assert shown.run.phase is Phase.RUNNING
        assert shown.run.notes == ()
        answers = [answer.exception(30.0) for answer in (sent, *filling[:-1])]
        assert {str(error) for error in answers} == {NO_ANSWER}
        assert took(engine, Abort("now")) < 5.0


@pytest.mark.slow
def test_a_screen_says_within_two_seconds_that_its_engine_is_silent(tmp_path: Path) -> None:
    with EngineProcess(tmp_path / "runs", "no-touch") as engine:
        link = EngineLink(lambda: engine.client, time.monotonic)
        link.connect()
        engine.start(make_setup(countdown=1.0, timeout=600.0))

        def words() -> str:
            snapshot = link.snapshot()
            assert snapshot is not None
            return snapshot.pulse.words or ""

        assert words() == ""
        with held(engine):
            began = time.monotonic()
            until(lambda: words().startswith("the engine is silent for 1 s"))
            said = time.monotonic() - began
            until(lambda: words().startswith("the engine is silent for 3 s"))
        until(lambda: words() == "")
    print(f"\nthe engine is silent: said after {1000 * said:.0f} ms")
    assert said < 2.0


IN_VAIN = 12
"""Screens that try once more: each is told at once."""

NONE_LEFT = 3
"""A limit below all that are open: whatever is closed meanwhile makes no room for another."""


def processor_time(engine: EngineProcess) -> float:
    words = Path(f"/proc/{engine.process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def test_twenty_screens_attach_and_four_places_are_for_who_may_act(tmp_path: Path) -> None:
    with EngineProcess(tmp_path / "runs", "nominal") as engine, ExitStack() as stack:
        engine.start(make_setup(timeout=60.0))
        shown: list[RemoteEngine] = []

        def attach(role: Role, most: int) -> None:
            """As many as are let in; every further one is told so."""
            for _ in range(most - 1 - len(shown)):
                shown.append(RemoteEngine(engine.name, role, "a screen"))
                stack.callback(shown[-1].close)
            refused = f"{most} screens are attached, the most: close one"
            for _ in range(IN_VAIN):
                with pytest.raises(MadrobError, match=refused):
                    RemoteEngine(engine.name, role, "one too many")

        attach(Role.WATCH, MOST_SCREENS - FOR_REFEREES)
        attach(Role.REFEREE, MOST_SCREENS)
        engine.act(Abort("enough"))
        for screen in shown:
            until(lambda s=screen: s.snapshot().run.phase is Phase.STOPPED)  # type: ignore[misc]
        assert engine.result()["outcome"] == "aborted"
        assert engine.log.read_text() == ""


def test_without_file_handles_screens_wait_and_the_log_says_it_once(
    tmp_path: Path,
) -> None:
    with EngineProcess(tmp_path / "runs", "nominal") as engine:
        limits = resource.prlimit(engine.process.pid, resource.RLIMIT_NOFILE)
        resource.prlimit(engine.process.pid, resource.RLIMIT_NOFILE, (NONE_LEFT, limits[1]))
        before, begin = processor_time(engine), time.monotonic()
        with pytest.raises(TimeoutError):
            RemoteEngine(engine.name, Role.WATCH, "a watcher")
        assert processor_time(engine) - before < 0.5 * (time.monotonic() - begin)
        assert engine.snapshot().run.phase is Phase.IDLE
        said = engine.log.read_text()
        assert said.count("new screens must wait ([Errno 24] Too many open files)\n") == 1
        assert "socket.accept" not in said
        resource.prlimit(engine.process.pid, resource.RLIMIT_NOFILE, limits)
        with closing(RemoteEngine(engine.name, Role.WATCH, "a watcher")) as watcher:
            assert until(lambda: watcher.snapshot().run.phase is Phase.IDLE)
