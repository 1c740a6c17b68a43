"""From the command line to the engine of the testbed that it names, started if there is none."""

from __future__ import annotations

import argparse
import getpass
import os
import shlex
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, assert_never

from madrob_console.cli import options
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind
from madrob_console.config import Settings
from madrob_console.engine import wire
from madrob_console.engine.control import ENDING
from madrob_console.engine.discovery import FoundEngine, found_at
from madrob_console.engine.engine_lock import Owned, Place, owned_by, place_of
from madrob_console.engine.requests import Role
from madrob_console.testbeds.ros_domain import domain_id

if TYPE_CHECKING:
    from madrob_console.engine.client import RemoteEngine

STARTING_TIME = 30.0
"""Timeout for an engine to appear after its start, s."""

TAKEN = 75
"""Exit code of an engine whose testbed already has one; EX_TEMPFAIL of sysexits."""

_ANSWERING_TIME = 5.0
"""Timeout for an engine to identify itself, after which it counts as hung, s."""

_PERIOD = 0.02

_NOTHING_TO_WATCH = (
    "no engine runs here to be watched: `madrob console` starts one, `madrob engine status` lists "
    "them"
)


def who_am_i() -> str:
    try:
        user = getpass.getuser()
    except (OSError, KeyError):  # a user without a name
        user = str(os.getuid())
    connection = os.environ.get("SSH_CONNECTION", "").partition(" ")[0]
    return f"{user}@{connection or socket.gethostname()} ({os.getpid()})"


def owned_testbed(arguments: argparse.Namespace, settings: Settings) -> Owned:
    """Names that the testbed's engine owns; the same command line gives the same names."""
    named = arguments.testbed or [settings.testbed.kind or SourceKind.ROS]
    kind = SourceKind(named[0])
    results = options.results_folder(arguments, settings).resolve()
    if kind is not SourceKind.SIMULATED and (arguments.latency or arguments.jitter):
        raise MadrobError(
            "--latency and --jitter delay simulated messages: use them with `--testbed simulated` "
            "or `madrob testbed`"
        )
    match kind:
        case SourceKind.ROS:
            if arguments.speed != 1:
                raise MadrobError("--speed: a live testbed has its own; leave the option out")
            domain = domain_id(options.ros_domain(arguments, settings), os.environ)
            return owned_by(kind, domain, results=results)
        case SourceKind.REPLAY:  # nothing is kept, and its keys change the speed
            paths = (Path(path).expanduser().absolute() for path in named[1:])
            return owned_by(kind, *paths, results=None)
        case SourceKind.SIMULATED:
            what = (getattr(arguments, name) for name in options.SIMULATION)
            return owned_by(kind, results, *what, results=results)
        case _:
            assert_never(kind)


def attach(arguments: argparse.Namespace, settings: Settings, role: Role) -> RemoteEngine:
    """Attach to the engine; a referee's console starts it where none runs."""
    owned = owned_testbed(arguments, settings)
    who = who_am_i()
    if (engine := _running(owned, role, who)) is not None:
        return _checked(engine, arguments, settings)
    if role is Role.WATCH:
        raise MadrobError(_NOTHING_TO_WATCH)
    place = place_of(owned)
    process = _start(arguments, place)
    end = time.monotonic() + STARTING_TIME
    while time.monotonic() < end:
        ended = process.poll() is not None
        if (engine := _running(owned, role, who)) is not None:
            return engine
        if ended and process.returncode != TAKEN:  # another console's engine comes, then
            raise MadrobError(_last_words(place))
        time.sleep(_PERIOD)
    raise MadrobError(f"the engine did not start within {STARTING_TIME:g} s: see {place.log}")


def demand_engine(arguments: argparse.Namespace, settings: Settings) -> None:
    owned = owned_testbed(arguments, settings)
    if _found(owned) is None and not _listens(place_of(owned).socket):
        raise MadrobError(_NOTHING_TO_WATCH)


def _running(owned: Owned, role: Role, who: str) -> RemoteEngine | None:
    from madrob_console.engine.client import RemoteEngine

    end = time.monotonic() + STARTING_TIME
    while (found := _found(owned)) is not None:
        if (socket_path := _socket_of(found)) is not None:
            with suppress(OSError):  # it is lost, and made again in a moment
                return RemoteEngine(socket_path, role, who, found.pid)
        if time.monotonic() > end:
            raise MadrobError(f"the engine ({found.who}) {_not_yet(found)}: {found.end_words}")
        time.sleep(_PERIOD)
    try:
        return RemoteEngine(place_of(owned).socket, role, who)  # it has no name, if it is there
    except OSError:
        return None


def _found(owned: Owned) -> FoundEngine | None:
    with suppress(MadrobError):
        return found_at(owned.testbed, _ANSWERING_TIME)
    return None


def _listens(path: Path) -> bool:
    """Whether a process listens on a socket: an engine may hold no other name."""
    with socket.socket(socket.AF_UNIX) as connection:
        return connection.connect_ex(str(path)) == 0


def _socket_of(found: FoundEngine) -> Path | None:
    """Socket on which an engine accepts screens; None: not yet; MadrobError: it accepts none."""
    presence = found.presence
    ends_it = found.end_words
    if presence is None:
        killed = "; it was killed and waits for a disk" if found.killed else ""
        raise MadrobError(f"the engine is there, but silent ({found.who}{killed}): {ends_it}")
    if not presence.wire:
        raise MadrobError(
            f"a `madrob run` has the testbed ({found.who}): wait for its end, or {ends_it}"
        )
    if presence.wire != wire.VERSION:
        raise MadrobError(
            f"the engine ({found.who}) speaks version {presence.wire}, this console "
            f"{wire.VERSION}: {ends_it}, then start the console again"
        )
    if presence.phase == ENDING:
        return None  # it is soon gone
    return Path(presence.socket) if presence.socket else None


def _not_yet(found: FoundEngine) -> str:
    if found.presence is not None and found.presence.phase == ENDING:
        return "is ending and not gone yet: a disk may hold it up"
    return "has no socket for screens yet"


def _checked(
    engine: RemoteEngine, arguments: argparse.Namespace, settings: Settings
) -> RemoteEngine:
    """Refuse an engine that keeps its runs in another folder than the one that was meant."""
    wanted = options.results_folder(arguments, settings)
    named = arguments.testbed and arguments.testbed[0] == SourceKind.REPLAY
    if not named and engine.results.resolve() != wanted.resolve():
        engine.close()
        raise MadrobError(
            f"the engine of this testbed (pid {engine.pid}) keeps its runs in {engine.results}: "
            "use that with --results, or end it with `madrob engine stop --results "
            f"{shlex.quote(str(engine.results))}`"
        )
    return engine


def _start(arguments: argparse.Namespace, place: Place) -> subprocess.Popen[bytes]:
    """Start the engine in a session of its own: no hang-up of this terminal reaches it."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
    log = os.open(place.log, flags, 0o600)
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


def engine_options(arguments: argparse.Namespace) -> list[str]:
    words: list[str] = []
    names = (*options.SIMULATION, "domain", "results", "settings")
    for name in (*names, "teams", "plan", "idle_time"):
        value = getattr(arguments, name)
        if value is not None:
            words.append(f"--{name.replace('_', '-')}={value}")
    if arguments.testbed is not None:
        words += ["--testbed", *arguments.testbed]
    if arguments.use_sim_time:
        words.append("--use-sim-time")
    return [*words, *ros_words(arguments)]


def ros_words(arguments: argparse.Namespace) -> list[str]:
    return ["--ros-args", *arguments.ros_args] if arguments.ros_args else []


def _last_words(place: Place) -> str:
    try:
        lines = place.log.read_text(errors="replace").strip().splitlines()
    except OSError:
        lines = []
    return lines[-1].removeprefix("madrob: ") if lines else "the engine ended without a word"
