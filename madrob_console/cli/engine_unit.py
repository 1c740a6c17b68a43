"""`madrob engine unit`: the systemd service of an engine."""

from __future__ import annotations

import argparse
import getpass
import math
import os
import sys
from collections.abc import Iterable, Iterator
from importlib import resources
from pathlib import Path
from string import Template

from madrob_console.cli import option_values
from madrob_console.cli.attaching import TAKEN, engine_options, owned_testbed
from madrob_console.cli.output import BAD_INPUT
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import make_folder
from madrob_console.common.names import SourceKind
from madrob_console.engine.ipc.engine_sockets import state_folder

_ROS_ENVIRONMENT = (
    *("AMENT_PREFIX_PATH", "LD_LIBRARY_PATH", "PYTHONPATH", "ROS_DISTRO", "ROS_VERSION"),
    *("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY"),
    *("ROS_DISCOVERY_SERVER", "RMW_IMPLEMENTATION", "CYCLONEDDS_URI"),
    *("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"),
)
"""Variables copied from the shell that prints the unit: where ROS is, and whom it finds."""


_SANDBOX = """\
# It writes into these folders alone: add those that the command of [results] needs.
ProtectSystem=strict
ReadWritePaths={writable}
LogsDirectory=madrob
Environment=ROS_LOG_DIR=%L/madrob
PrivateTmp=yes
PrivateDevices=yes
ProtectClock=yes
ProtectControlGroups=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
CapabilityBoundingSet="""
"""Of a system service: a user's own manager may be without the name spaces that it needs."""


def print_unit(arguments: argparse.Namespace) -> int:
    """Print `engine.service`, filled in; makes the folders that a system service writes to."""
    settings = option_values.settings_of(arguments)
    owned = owned_testbed(arguments, settings)
    if owned.kind is SourceKind.REPLAY:
        raise MadrobError("a replay needs no service: use --testbed ros or simulated")
    assert owned.results is not None
    arguments.testbed, arguments.domain = [owned.kind.value], owned.domain
    arguments.results, arguments.idle_time = owned.results, arguments.idle_time or math.inf
    system = arguments.system
    writable = [owned.results, state_folder()]
    if settings.results.publish:
        writable.append(Path(settings.results.publish).expanduser())
    for folder in writable if system else ():
        make_folder(folder, "make it, then print the unit again")  # else it does not start
    names = _ROS_ENVIRONMENT if owned.kind is SourceKind.ROS else ()
    template = resources.files("madrob_console") / "cli" / "engine.service"
    filled = Template(template.read_text(encoding="utf-8")).substitute(
        name=f"madrob-{owned.stem.replace('_', '-')}",
        testbed=owned.words,
        network="Wants=network-online.target\nAfter=network-online.target" if system else "",
        user=f"User={getpass.getuser()}" if system else "",
        results=_quoted([str(owned.results)]),
        sandbox=_SANDBOX.format(writable=_quoted(map(str, writable))) if system else "",
        folder=str(Path.cwd()).replace("%", "%%"),
        serve=_quoted([*_command_line(), "engine", "serve", *engine_options(arguments)]),
        environment="\n".join(
            f"Environment={_quoted([f'{name}={value}'])}"
            for name, value in _environment(("XDG_STATE_HOME", *names))
        ),
        target="multi-user" if system else "default",
        taken=TAKEN,
        bad_input=BAD_INPUT,
    )
    print(filled, end="")
    return 0


def _command_line() -> list[str]:
    """This `madrob`, with its absolute path."""
    script = Path(sys.executable).with_name("madrob")
    if script.is_file():
        return [str(script)]
    return [sys.executable, "-P", "-m", "madrob_console.cli.main"]


def _environment(names: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Variables of this shell, without the paths that this Python finds by itself."""
    for name in names:
        value = os.environ.get(name, "")
        if name.endswith("PATH"):
            parts = (part for part in value.split(os.pathsep) if not part.startswith(sys.prefix))
            value = os.pathsep.join(parts)
        if value:
            yield name, value


def _quoted(words: Iterable[str]) -> str:
    """Words of a line of a unit file (systemd.syntax(7)): nothing in them is expanded."""
    return " ".join(_word(word) for word in words)


def _word(word: str) -> str:
    if any(ord(sign) < 32 for sign in word):
        raise MadrobError(f"{word!r}: no service can be given that; use another path")
    word = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{word}"' if set(word) & set(" \t'\"\\;") else word
