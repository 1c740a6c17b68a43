"""An engine that may open few files, or none any more, and screens that are too many for it."""

from __future__ import annotations

import os
import resource
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import pytest

from madrob_console.engine.process.accepting import SPARE, WANTED_HANDLES
from madrob_console.engine.process.remote import RemoteEngine
from madrob_console.engine.shown.requests import Role
from madrob_console.errors import MadrobError
from madrob_console.referee.acts import Abort
from madrob_console.referee.run import Phase
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine_process import EngineProcess
from tests.watching import until

IN_VAIN = 12
"""Screens that try once more: each is told at once."""

NONE_LEFT = 3
"""A limit below all that are open: whatever is closed meanwhile makes no room for another."""


@contextmanager
def limited(results: Path, limits: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[EngineProcess]:
    """An engine that was started under a shell's `ulimit`s."""
    shell = results.with_name("python")
    shell.write_text(f'#!/bin/sh\n{limits}\nexec {sys.executable} "$@"\n')
    shell.chmod(0o755)
    with monkeypatch.context() as patched:
        patched.setattr(sys, "executable", str(shell))
        engine = EngineProcess(results, "nominal")
    with engine:
        yield engine


def handles(engine: EngineProcess) -> int:
    return len(list(Path(f"/proc/{engine.process.pid}/fd").iterdir()))


def processor_time(engine: EngineProcess) -> float:
    words = Path(f"/proc/{engine.process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def test_more_screens_than_file_handles_take_nothing_from_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with limited(tmp_path / "runs", "ulimit -n 256", monkeypatch) as engine, ExitStack() as stack:
        engine.start(make_setup(timeout=60.0))
        refused: list[str] = []
        attached = 1
        while len(refused) < IN_VAIN:
            try:
                watcher = RemoteEngine(engine.socket, Role.WATCH, "a watcher")
            except MadrobError as error:
                refused.append(str(error))
            else:
                attached += 1
                assert attached < 256
                stack.enter_context(closing(watcher))
        assert attached >= 100
        assert all("screens are attached" in why and "ulimit -n" in why for why in refused)
        with closing(RemoteEngine(engine.socket, Role.REFEREE, "another referee")):
            pass  # one comes in whatever the watchers do
        begin = time.monotonic()
        engine.act(Abort("enough"))
        assert time.monotonic() - begin < 2.0
        assert engine.snapshot().run.phase is Phase.STOPPED
        assert engine.result()["outcome"] == "aborted"
        assert engine.snapshot().faults == ()
        assert handles(engine) < 256 - SPARE
        assert engine.log.read_text() == ""


def test_without_file_handles_screens_wait_and_the_log_says_it_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with limited(tmp_path / "runs", ":", monkeypatch) as engine:
        limits = resource.prlimit(engine.process.pid, resource.RLIMIT_NOFILE)
        resource.prlimit(engine.process.pid, resource.RLIMIT_NOFILE, (NONE_LEFT, limits[1]))
        before, begin = processor_time(engine), time.monotonic()
        with pytest.raises(MadrobError, match="does not answer"):
            RemoteEngine(engine.socket, Role.WATCH, "a watcher")
        assert processor_time(engine) - before < 0.5 * (time.monotonic() - begin)
        assert engine.snapshot().run.phase is Phase.IDLE
        said = engine.log.read_text()
        assert said.count("new screens must wait ([Errno 24] Too many open files)\n") == 1
        assert "socket.accept" not in said
        resource.prlimit(engine.process.pid, resource.RLIMIT_NOFILE, limits)
        with closing(RemoteEngine(engine.socket, Role.WATCH, "a watcher")) as watcher:
            assert until(lambda: watcher.snapshot().run.phase is Phase.IDLE)


def test_an_engine_has_as_many_file_handles_as_it_may(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with limited(tmp_path / "runs", "ulimit -S -n 200", monkeypatch) as engine:
        soft, _ = resource.prlimit(engine.process.pid, resource.RLIMIT_NOFILE)
        assert soft == (
            WANTED_HANDLES if hard == resource.RLIM_INFINITY else min(hard, WANTED_HANDLES)
        )
