"""`madrob engine unit`: the systemd service of an engine."""

from __future__ import annotations

import argparse
import getpass
import os
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from madrob_console.cli import options
from madrob_console.cli.attaching import TAKEN, owned_testbed, ros_words
from madrob_console.cli.problems import BAD_INPUT
from madrob_console.config import Settings, load_settings
from madrob_console.engine.process.owned import Owned
from madrob_console.errors import MadrobError
from madrob_console.kinds import SourceKind

WATCHDOG = 15
"""The service manager ends an engine whose core hangs for so long, s, and starts it again."""

ENDING = 120
"""An engine has so long to close its recording and write the result when it is stopped, s."""

_ROS_ENVIRONMENT = (
    *("AMENT_PREFIX_PATH", "LD_LIBRARY_PATH", "PYTHONPATH", "ROS_DISTRO", "ROS_VERSION"),
    *("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY"),
    *("ROS_DISCOVERY_SERVER", "RMW_IMPLEMENTATION", "CYCLONEDDS_URI"),
    *("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"),
)
"""Of the shell that prints the unit: where ROS is, and whom it finds."""


def print_unit(arguments: argparse.Namespace) -> int:
    """Print the service of the testbed that the command line names.

    Raises:
        MadrobError: a replay needs no service.
    """
    settings = load_settings(arguments.settings)
    owned = owned_testbed(arguments, settings)
    if owned.kind is SourceKind.REPLAY:
        raise MadrobError("a replay needs no service: use --testbed ros or simulated")
    print("\n".join(unit_lines(arguments, settings, owned, os.environ)))
    return 0


def unit_lines(
    arguments: argparse.Namespace, settings: Settings, owned: Owned, environment: Mapping[str, str]
) -> Iterator[str]:
    """The lines of the service.

    Args:
        arguments: the command line: those of `serve`, and `system`.
        settings: its settings.
        owned: by its engine.
        environment: what of it ROS needs goes with the service.
    """
    name = f"madrob-{owned.stem.replace('_', '-')}"
    testbed = _testbed(arguments, settings, owned)
    madrob = command_line()
    yield from _head(name, arguments, system=arguments.system)
    yield "[Unit]"
    yield f"Description=MADROB referee engine, {owned.words}"
    if arguments.system:
        yield "Wants=network-online.target"
        yield "After=network-online.target"
    yield "StartLimitIntervalSec=0"
    yield ""
    yield "[Service]"
    if arguments.system:
        yield f"User={getpass.getuser()}"
    yield "Type=notify"
    idle = "inf" if arguments.idle_time is None else f"{arguments.idle_time:g}"
    teams = options.team_source(arguments, settings).file if arguments.teams else None
    listed = [] if teams is None else [f"--teams={teams}"]
    plan = options.plan_source(arguments, settings).file if arguments.plan else None
    listed += [] if plan is None else [f"--plan={plan}"]
    serve = [
        *madrob,
        "engine",
        "serve",
        *testbed,
        *listed,
        f"--idle-time={idle}",
        *ros_words(arguments),
    ]
    yield f"ExecStart={_quoted(serve)}"
    yield f"ExecStop={_quoted([*madrob, 'engine', 'stop', '--force', *testbed])}"
    yield "Restart=on-failure"
    yield "RestartSec=2"
    yield f"RestartPreventExitStatus={BAD_INPUT}"
    yield f"WatchdogSec={WATCHDOG}"
    yield f"TimeoutStopSec={ENDING}"
    yield "KillMode=mixed"
    yield "OOMPolicy=continue"
    yield f"RuntimeDirectory={name}"
    yield "RuntimeDirectoryMode=0700"
    yield f"Environment=XDG_RUNTIME_DIR=%t/{name}"
    if owned.kind is SourceKind.ROS:
        for variable, value in _ros_environment(environment):
            yield f"Environment={_quoted([f'{variable}={value}'])}"
    yield ""
    yield "[Install]"
    yield f"WantedBy={'multi-user' if arguments.system else 'default'}.target"


def command_line() -> list[str]:
    """This `madrob`, with its whole path."""
    script = Path(sys.executable).with_name("madrob")
    if script.is_file():
        return [str(script)]
    return [sys.executable, "-P", "-m", "madrob_console.cli.main"]


def _head(name: str, arguments: argparse.Namespace, *, system: bool) -> Iterator[str]:
    words = [word for word in sys.argv[1:] if word != "--system"]
    again = shlex.join(["madrob", *words]) if words[:1] == ["engine"] else "madrob engine unit"
    if system:
        yield "# As root, once; the engine is that of its user, whose consoles find it:"
        yield f"#   {again} --system | sudo tee /etc/systemd/system/{name}.service"
        yield f"#   sudo systemctl daemon-reload && sudo systemctl enable --now {name}"
        yield f"#   journalctl -u {name} -f"
    else:
        yield "# As its user, once; with lingering it runs without a login, from boot on:"
        yield "#   mkdir -p ~/.config/systemd/user"
        yield f"#   {again} > ~/.config/systemd/user/{name}.service"
        yield f"#   systemctl --user daemon-reload && systemctl --user enable --now {name}"
        yield "#   loginctl enable-linger"
        yield f"#   journalctl --user -u {name} -f"
    yield f"# Exit code {TAKEN}: the engine of a console has the testbed; this one follows it."
    yield ""


def _ros_environment(environment: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """What ROS needs of the environment; what lies in this Python's folder it finds by itself."""
    for name in _ROS_ENVIRONMENT:
        value = environment.get(name, "")
        if name.endswith("PATH"):
            parts = (part for part in value.split(os.pathsep) if not part.startswith(sys.prefix))
            value = os.pathsep.join(parts)
        if value:
            yield name, value


def _testbed(arguments: argparse.Namespace, settings: Settings, owned: Owned) -> list[str]:
    """The options that name the testbed wherever they are read: all paths whole."""
    words = [f"--results={options.results_folder(arguments, settings)}"]
    if owned.domain is not None:
        words.insert(0, f"--domain={owned.domain}")
    else:
        values = ((name, getattr(arguments, name)) for name in options.SIMULATION)
        words += [f"--{name}={value}" for name, value in values if value is not None]
    if arguments.settings is not None:
        words.append(f"--settings={arguments.settings.expanduser().absolute()}")
    if arguments.use_sim_time:
        words.append("--use-sim-time")
    return ["--testbed", owned.kind.value, *words]


def _quoted(words: Sequence[str]) -> str:
    """Words of a line of a unit file (systemd.syntax(7)): nothing in them is expanded.

    Raises:
        MadrobError: a word cannot stand in a unit file.
    """
    return " ".join(_word(word) for word in words)


def _word(word: str) -> str:
    if any(ord(sign) < 32 for sign in word):
        raise MadrobError(f"{word!r}: no service can be given that; use another path")
    word = word.replace("\\", "\\\\").replace('"', '\\"').replace("%", "%%").replace("$", "$$")
    return f'"{word}"' if set(word) & set(" \t'\"\\;") else word
