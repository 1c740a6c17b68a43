from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from madrob_console.errors import MadrobError
from madrob_console.ui.terminal import check_terminal
from tests.terminal import Terminal

pytestmark = pytest.mark.machine
ROOT = Path(__file__).parents[3]
PROGRAM = [sys.executable, "-m", "tests.madrob_console.ui.moving_engine"]
F8, F10 = "\x1b[19~", "\x1b[21~"
LAST_KEY = "F10Quit"
STARTING = 30.0
COLOURS = re.compile(rb"\x1b\[(?:\d+;)*(?:3[0-9]|4[0-9]|9[0-7]|10[0-7])(?:;\d+)*m")
LEAVE_SCREEN, SHOW_CURSOR = b"\x1b[?1049l", b"\x1b[?25h"


@pytest.fixture
def running() -> Iterator[Terminal]:
    with Terminal([*PROGRAM, "--running"], cwd=ROOT) as terminal:
        terminal.wait_for(LAST_KEY, timeout=STARTING)
        yield terminal


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_cleanly_and_restores_the_terminal(
    running: Terminal, number: signal.Signals
) -> None:
    os.kill(running.pid, number)
    assert running.wait_exit() == 128 + number
    assert LEAVE_SCREEN in running.output
    assert SHOW_CURSOR in running.output


def test_a_terminal_that_goes_ends_the_console_soon() -> None:
    with Terminal([*PROGRAM, "--running"], cwd=ROOT) as terminal:
        terminal.wait_for(LAST_KEY, timeout=STARTING)
        terminal.hang_up()
        assert terminal.wait_exit(10.0) == 128 + signal.SIGHUP


def test_a_signal_ends_the_console_even_if_its_terminal_takes_nothing(running: Terminal) -> None:
    time.sleep(6.0)  # nobody reads: the pty and the queue before it fill up
    os.kill(running.pid, signal.SIGHUP)
    assert running.wait_exit_unread(8.0) == 128 + signal.SIGHUP


def test_quitting_a_run_asks_and_then_restores_the_terminal(running: Terminal) -> None:
    running.send(F10)
    running.wait_for("LEAVE the console while a run goes on")
    running.send("y")
    assert running.wait_exit() == 0
    assert LEAVE_SCREEN in running.output


def test_no_color_means_no_colour_and_everything_still_reads() -> None:
    with Terminal([*PROGRAM, "--running"], env={"NO_COLOR": "1"}, cwd=ROOT) as terminal:
        terminal.wait_for(LAST_KEY, timeout=STARTING)
        terminal.wait_for("~~ SIMULATED nominal ~~")
        terminal.send(F8)
        terminal.wait_for("> n no, the run goes on")
        assert not COLOURS.findall(bytes(terminal.output))


def test_the_error_output_may_go_elsewhere(tmp_path: Path) -> None:
    errors = tmp_path / "errors"
    command = f"exec {shlex.join(PROGRAM)} 2>{shlex.quote(str(errors))}"
    with Terminal(["sh", "-c", command], cwd=ROOT) as terminal:
        terminal.wait_for(LAST_KEY, timeout=STARTING)
        terminal.send(F10)
        assert terminal.wait_exit() == 0
        assert LEAVE_SCREEN in terminal.output
    assert errors.read_bytes() == b""


@pytest.mark.parametrize("term", ["dumb", "", "unknown"])
def test_a_terminal_that_cannot_show_screens_is_refused(term: str) -> None:
    with pytest.raises(MadrobError, match="use `madrob run`"):
        check_terminal({"TERM": term} if term else {})


@pytest.mark.parametrize("term", ["xterm-256color", "tmux-256color", "screen", "linux", "vt100"])
def test_other_terminals_are_not(term: str) -> None:
    check_terminal({"TERM": term})


def test_the_screens_import_nothing_slow() -> None:
    code = (
        "import sys, madrob_console.ui.terminal;"
        "print(*{m.partition('.')[0] for m in sys.modules} & {'scipy', 'pandas', 'rclpy', 'numpy'})"
    )
    output = subprocess.check_output([sys.executable, "-c", code], cwd=ROOT, text=True)
    assert output.strip() == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("columns", "lines", "most"), [(80, 24, 8_000), (120, 36, 10_000), (160, 50, 12_000)]
)
def test_a_live_run_is_light_on_the_line(columns: int, lines: int, most: float) -> None:
    with Terminal([*PROGRAM, "--running"], columns, lines, cwd=ROOT) as terminal:
        terminal.wait_for("Quit", timeout=STARTING)
        assert bytes_per_second(terminal, 6.0) <= most


@pytest.mark.slow
def test_an_idle_console_hardly_writes() -> None:
    with Terminal(PROGRAM, cwd=ROOT) as terminal:
        terminal.wait_for(LAST_KEY, timeout=STARTING)
        assert bytes_per_second(terminal, 4.0) <= 1_000


def bytes_per_second(terminal: Terminal, duration: float) -> float:
    """What the terminal is sent, after a second to settle."""
    watch(terminal, 1.0)
    before, began = len(terminal.output), time.monotonic()
    watch(terminal, duration)
    return (len(terminal.output) - before) / (time.monotonic() - began)


def watch(terminal: Terminal, duration: float) -> None:
    """Read what comes, as a terminal does."""
    end = time.monotonic() + duration
    while time.monotonic() < end:
        terminal.screen()
        time.sleep(0.02)
