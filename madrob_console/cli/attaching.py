"""From the command line to the engine of the testbed that it names, started if there is none."""

from __future__ import annotations

import argparse
import getpass
import os
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli import options
from madrob_console.config import Settings
from madrob_console.engine.process.place import Place, known_places, place_of
from madrob_console.engine.shown.requests import Role
from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind

if TYPE_CHECKING:
    from madrob_console.engine.process.remote import RemoteEngine

STARTING_TIME = 30.0
"""An engine that is not there after this time will not come, s."""

TAKEN = 75
"""Exit code of an engine that finds its testbed's engine running; EX_TEMPFAIL of sysexits."""

_PERIOD = 0.02


def who_am_i() -> str:
    """This console, for the people at the others."""
    try:
        user = getpass.getuser()
    except (OSError, KeyError):  # a user without a name
        user = str(os.getuid())
    connection = os.environ.get("SSH_CONNECTION", "").partition(" ")[0]
    return f"{user}@{connection or socket.gethostname()} ({os.getpid()})"


def engine_place(arguments: argparse.Namespace, settings: Settings) -> Place:
    """Where the engine of the testbed is found: the same words, the same place.

    Raises:
        MadrobError: there is no folder for its socket.
    """
    named = arguments.testbed or [settings.testbed.kind or SourceKind.ROS]
    kind = str(named[0])
    if kind == SourceKind.ROS:
        domain = options.ros_domain(arguments, settings)
        return place_of(kind, os.environ.get("ROS_DOMAIN_ID", "0") if domain is None else domain)
    if kind == SourceKind.REPLAY:  # nothing is kept, and its keys change the speed
        return place_of(kind, *(Path(path).expanduser().absolute() for path in named[1:]))
    results = options.results_folder(arguments, settings)
    return place_of(kind, results, arguments.scenario, arguments.seed, arguments.speed)


def attach(arguments: argparse.Namespace, settings: Settings, role: Role) -> RemoteEngine:
    """Attach to the engine; a referee's console starts it where none runs.

    Raises:
        MadrobError: there is none and none can be started; the message says why.
    """
    from madrob_console.engine.process.remote import RemoteEngine

    place = engine_place(arguments, settings)
    who = who_am_i()
    try:
        return _checked(RemoteEngine(place.socket, role, who), arguments, settings)
    except OSError:
        if role is Role.WATCH:
            if arguments.testbed is None and (only := _only_engine(role, who)) is not None:
                return only
            raise MadrobError(
                "no engine runs here to be watched: `madrob console` starts one, `madrob engine "
                "status` lists them"
            ) from None
    process = _start(arguments, place)
    end = time.monotonic() + STARTING_TIME
    while time.monotonic() < end:
        ended = process.poll() is not None
        try:
            return RemoteEngine(place.socket, role, who)
        except OSError:
            if ended and process.returncode != TAKEN:  # another console's engine comes, then
                raise MadrobError(_last_words(place)) from None
        time.sleep(_PERIOD)
    raise MadrobError(f"the engine did not start within {STARTING_TIME:g} s: see {place.log}")


def _only_engine(role: Role, who: str) -> RemoteEngine | None:
    """The engine that runs; None where there is none, or more than one."""
    from madrob_console.engine.process.remote import RemoteEngine

    found: list[RemoteEngine] = []
    for place in known_places():
        with suppress(OSError, MadrobError):  # it was killed, or is just ending
            found.append(RemoteEngine(place.socket, role, who))
    if len(found) == 1:
        return found[0]
    for engine in found:
        engine.close()
    return None


def _checked(
    engine: RemoteEngine, arguments: argparse.Namespace, settings: Settings
) -> RemoteEngine:
    """An engine that keeps its runs elsewhere is not the one that was meant."""
    wanted = options.results_folder(arguments, settings)
    named = arguments.testbed and arguments.testbed[0] == SourceKind.REPLAY
    if not named and engine.results != wanted:
        engine.close()
        raise MadrobError(
            f"the engine of this testbed keeps its runs in {engine.results}: use that with "
            "--results, or end it with `madrob engine stop`"
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
                "-m",
                "madrob_console.cli.main",
                "engine",
                "serve",
                *_testbed_options(arguments),
            ],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
    finally:
        os.close(log)


def _testbed_options(arguments: argparse.Namespace) -> list[str]:
    """The options of the testbed, as they were given."""
    words: list[str] = []
    for name in ("scenario", "seed", "speed", "domain", "results", "settings", "idle_time"):
        value = getattr(arguments, name)
        if value is not None:
            words.append(f"--{name.replace('_', '-')}={value}")
    if arguments.testbed is not None:
        words += ["--testbed", *arguments.testbed]
    return words


def _last_words(place: Place) -> str:
    """Why the engine ended, as it said itself."""
    try:
        lines = place.log.read_text(errors="replace").strip().splitlines()
    except OSError:
        lines = []
    return lines[-1].removeprefix("madrob: ") if lines else "the engine ended without a word"
