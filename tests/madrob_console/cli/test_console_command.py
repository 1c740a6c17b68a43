"""What `madrob console` and `madrob watch` refuse before they take the terminal."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from recorder.writer import BagWriter
from tests.madrob_console.recorded_runs import completed
from tests.recorder.samples import door_messages, door_topics
from tests.terminal import Terminal

PROGRAM = [sys.executable, "-m", "madrob_console.cli"]

pytestmark = pytest.mark.machine


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("console --testbed sim", "there is no 'sim', did you mean simulated?"),
        ("console --testbed replay", "replay needs the path of one bag"),
        ("console --testbed replay /nowhere/at_all", "/nowhere/at_all"),
        ("console --testbed replay EMPTY", "the folder holds no recording"),
        ("watch --testbed ros --speed 5", "--speed: a live testbed has its own"),
        ("watch --testbed ros --latency 50ms", "--latency and --jitter delay simulated messages"),
        ("console --testbed replay RUN --jitter 1s", "delay simulated messages: use them with"),
        ("console --testbed simulated --teams /nowhere.csv", "correct --teams"),
        ("console --testbed simulated --plan /nowhere.csv", "correct --plan"),
        ("console --testbed replay RUN --from 900", "--from 900: the recording goes from -"),
        ("console --testbed replay RUN --at 900", "--at 900: the recording goes from -"),
        (
            "console --testbed replay RUN --at lunch",
            "--at: 'lunch' is no time and no event",
        ),
        ("console --testbed replay RUN --at stop --from 3", "in place of --from"),
        ("console --testbed simulated --at stop", "--at: give it with `--testbed replay PATH`"),
        ("console --testbed replay FOREIGN", "a bag without a MADROB run cannot be replayed"),
        ("watch --testbed replay RUN", "no engine runs here to be watched"),
        ("watch --testbed simulated", "no engine runs here to be watched"),
        ("console --settings /nowhere.toml", "no such settings file"),
        ("console --testbed simulated --from 3", "with `--testbed replay PATH` only"),
    ],
)
def test_nothing_is_painted_before_the_command_line_is_known_to_be_good(
    arguments: str, words: str, tmp_path: Path
) -> None:
    if "RUN" in arguments:
        arguments = arguments.replace("RUN", str(completed()))
    foreign = tmp_path / "foreign"
    if "FOREIGN" in arguments:
        with BagWriter(foreign, door_topics(), {}) as writer:
            writer.put(door_messages(rounds=1)[0])
    line = arguments.replace("FOREIGN", str(foreign)).replace("EMPTY", str(tmp_path)).split()
    where = {"XDG_CONFIG_HOME": str(tmp_path), "XDG_RUNTIME_DIR": str(tmp_path)}
    with Terminal([*PROGRAM, *line], columns=200, env=where) as terminal:
        assert terminal.wait_exit() == 2
        told = terminal.output.decode()
    assert words in told
    assert told.count("\n") == 1
    assert "\x1b" not in told


@pytest.mark.parametrize("command", ["console", "watch"])
def test_screens_are_not_painted_into_a_pipe(command: str, tmp_path: Path) -> None:
    ran = subprocess.run(
        [*PROGRAM, command, "--results", str(tmp_path)], stdin=subprocess.DEVNULL,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (ran.returncode, ran.stdout) == (2, "")
    assert ran.stderr.startswith("madrob: input and output are no terminal: ")
    assert ran.stderr.count("\n") == 1


def test_what_nothing_is_painted_of_yet_is_imported_after_the_first_paint(tmp_path: Path) -> None:
    code = (
        "import sys, madrob_console.ui.terminal as terminal\n"
        "late = {'madrob_console.engine.shown.snapshot', 'madrob_console.archive.unfinished'}\n"
        "terminal.check_terminal = lambda *_: None\n"
        "terminal.run_console = lambda *_, **__: print(late & set(sys.modules)) or 0\n"
        "from madrob_console.cli.main import main\n"
        "main(['console', '--testbed', 'simulated', '--results', sys.argv[1]])\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], env=os.environ | {"HOME": str(tmp_path)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert ran.stdout == "set()\n"
