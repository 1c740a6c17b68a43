"""From the command line to the engine of the testbed that it names, started if there is none."""

from __future__ import annotations

import argparse
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, assert_never

from madrob_console.cli import option_values, options
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.config import Settings
from madrob_console.engine.ipc import greeting
from madrob_console.engine.ipc.discovery import ask, find_engine, running_engines
from madrob_console.engine.ipc.engine_lock import Owned, owned_by, this_user
from madrob_console.engine.ipc.engine_sockets import no_state, state_folder
from madrob_console.engine.requests import Role
from madrob_console.testbeds.ros_domain import domain_id

if TYPE_CHECKING:
    from madrob_console.engine.ipc.client import RemoteEngine

STARTING_TIME = 30.0
"""Timeout for an engine to appear after its start, s."""

TAKEN = 75
"""Exit code of an engine whose testbed already has one; EX_TEMPFAIL of sysexits."""

_ENDING_TIME = 10.0
"""Timeout for an engine that nobody uses to end, s."""

_PERIOD = 0.02

_NOTHING_TO_WATCH = (
    "no engine runs here to be watched: `madrob console` starts one, `madrob engine status` lists "
    "them"
)


def who_am_i() -> str:
    connection = os.environ.get("SSH_CONNECTION", "").partition(" ")[0]
    return f"{this_user()}@{connection or socket.gethostname()} ({os.getpid()})"


def owned_testbed(arguments: argparse.Namespace, settings: Settings) -> Owned:
    """Names that the testbed's engine owns; the same command line gives the same names."""
    named = arguments.testbed or [settings.testbed.kind or SourceKind.ROS]
    kind = SourceKind(named[0])
    results = option_values.results_folder(arguments, settings).resolve()
    match kind:
        case SourceKind.ROS:
            if arguments.speed != 1:
                raise MadrobError("--speed: a live testbed has its own; leave the option out")
            domain = domain_id(option_values.ros_domain(arguments, settings), os.environ)
            return owned_by(kind, domain, results=results)
        case SourceKind.REPLAY:  # nothing is kept, and its keys change the speed
            paths = (Path(path).expanduser().absolute() for path in named[1:])
            return owned_by(kind, *paths, results=None)
        case SourceKind.SIMULATED:
            what = (getattr(arguments, name) for name in options.SIMULATION)
            return owned_by(kind, results, *what, results=results)
        case _:
            assert_never(kind)


def attach(
    arguments: argparse.Namespace, settings: Settings, role: Role, *, may_start: bool = True
) -> RemoteEngine:
    """Attach to the engine; a referee's console may start it where none runs."""
    from madrob_console.engine.ipc.client import NotYetError

    owned = owned_testbed(arguments, settings)
    process: subprocess.Popen[bytes] | None = None
    end = time.monotonic() + STARTING_TIME
    while True:
        late = time.monotonic() > end
        try:
            if (engine := _running(owned, role)) is not None:
                return _checked(engine, arguments, settings)
        except NotYetError as error:
            if late and (starting := find_engine(owned.stem)) is not None:
                raise MadrobError(
                    f"the engine ({starting.who}) {error}: {starting.end_words}"
                ) from None
        else:
            if role is Role.WATCH or not may_start:
                raise MadrobError(_NOTHING_TO_WATCH)
            if late:
                raise MadrobError(
                    f"the engine did not start within {STARTING_TIME:g} s: see {_log(owned)}"
                )
            process = _starting(process, arguments, owned)
        time.sleep(_PERIOD)


def _starting(
    process: subprocess.Popen[bytes] | None, arguments: argparse.Namespace, owned: Owned
) -> subprocess.Popen[bytes]:
    """The process of the engine that starts."""
    if process is None or process.poll() == TAKEN:  # another one comes, or has just gone
        _end_idle_practice(owned)
        return _start(arguments, owned)
    if process.returncode is not None:
        raise MadrobError(_last_words(owned))
    return process


def demand_engine(arguments: argparse.Namespace, settings: Settings) -> None:
    if find_engine(owned_testbed(arguments, settings).stem) is None:
        raise MadrobError(_NOTHING_TO_WATCH)


def _running(owned: Owned, role: Role) -> RemoteEngine | None:
    from madrob_console.engine.ipc.client import RemoteEngine

    try:
        return RemoteEngine(owned.stem, role, who_am_i())
    except TimeoutError:
        if (engine := find_engine(owned.stem)) is not None:
            raise MadrobError(
                f"the engine is there, but silent ({engine.who}): {engine.end_words}"
            ) from None
    except OSError:
        pass  # there is none, or it has just ended
    return None


def _end_idle_practice(owned: Owned) -> None:
    """End the simulated engine that nobody uses in the results folder of a live testbed."""
    for engine in running_engines() if owned.kind is SourceKind.ROS else ():
        answer = engine.answer
        if answer is None or answer.against_stopping or not answer.wire:  # a `madrob run`
            continue
        if (engine.kind, engine.results) == (SourceKind.SIMULATED, owned.results):
            with suppress(TimeoutError, MadrobError):
                ask(engine.stem, greeting.Stop())  # refused if it is used by now
            end = time.monotonic() + _ENDING_TIME
            while time.monotonic() < end and find_engine(engine.stem) is not None:
                time.sleep(_PERIOD)


def _checked(
    engine: RemoteEngine, arguments: argparse.Namespace, settings: Settings
) -> RemoteEngine:
    """Refuse an engine that keeps its runs in another folder than the one that was meant."""
    wanted = option_values.results_folder(arguments, settings)
    named = arguments.testbed and arguments.testbed[0] == SourceKind.REPLAY
    if not named and engine.results.resolve() != wanted.resolve():
        engine.close()
        raise MadrobError(
            f"the engine of this testbed (pid {engine.pid}) keeps its runs in {engine.results}: "
            f"use that with --results, or end it with `madrob engine stop --pid {engine.pid}`"
        )
    return engine


def _start(arguments: argparse.Namespace, owned: Owned) -> subprocess.Popen[bytes]:
    """Start the engine in a session of its own: no hang-up of this terminal reaches it."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
    try:
        log = os.open(_log(owned), flags, 0o600)
    except OSError as error:
        raise no_state(state_folder(), error) from None
    try:
        return subprocess.Popen(
            [
                sys.executable,
                "-P",
                "-m",
                "madrob_console.cli.main",
                "engine",
                "serve",
                *engine_options(arguments),
            ],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
    finally:
        os.close(log)


def option_words(arguments: argparse.Namespace, names: Iterable[str]) -> Iterator[str]:
    """The options of these names, as typed; those that are as by default are left out."""
    for name in names:
        flag, value = f"--{name.replace('_', '-')}", getattr(arguments, name)
        if value not in (None, arguments.parser.get_default(name)):
            yield flag if value is True else f"{flag}={value}"


def engine_options(arguments: argparse.Namespace) -> list[str]:
    names = ("domain", "results", "rehearsal", "settings", "teams", "plan", "idle_time")
    words = [*option_words(arguments, (*options.SIMULATION, *names))]
    if arguments.testbed is not None:
        words += ["--testbed", *arguments.testbed]
    return [*words, "--ros-args", *arguments.ros_args] if arguments.ros_args else words


def _log(owned: Owned) -> Path:
    return state_folder() / f"{owned.stem}.log"


def _last_words(owned: Owned) -> str:
    try:
        lines = _log(owned).read_text(errors="replace").strip().splitlines()
    except OSError:
        lines = []
    return lines[-1].removeprefix("madrob: ") if lines else "the engine ended without a word"
