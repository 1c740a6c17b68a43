from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from madrob_console.common.errors import MadrobError
from madrob_console.ui.terminal import check_terminal
from tests.madrob_console.ui.inline_engine import FOLDER
from tests.terminal import Terminal, Tmux

ROOT = Path(__file__).parents[3]
PROGRAM = [sys.executable, "-m", "tests.madrob_console.ui.inline_engine"]
CONSOLE = [*PROGRAM, "--running"]
F10 = "\x1b[21~"
LAST_KEY = "F1 more"
STARTING = 30.0
HUMAN = 0.5
"""Between two keys, s."""
LEAVE_SCREEN, SHOW_CURSOR = b"\x1b[?1049l", b"\x1b[?25h"


@contextmanager
def console(
    argv: Sequence[str] = CONSOLE, columns: int = 80, lines: int = 24, **env: str
) -> Iterator[Terminal]:
    """A console in a terminal, when it has drawn itself."""
    with Terminal(argv, columns, lines, env, ROOT) as terminal:
        terminal.wait_for(LAST_KEY, timeout=STARTING)
        yield terminal


@pytest.fixture
def running() -> Iterator[Terminal]:
    with console() as terminal:
        terminal.wait_for("F8 ABORT")  # of an engine; before that it is looked for
        yield terminal


@pytest.mark.machine
@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_cleanly_and_restores_the_terminal(
    running: Terminal, number: signal.Signals
) -> None:
    os.kill(running.pid, number)
    assert running.wait_exit() == 128 + number
    assert LEAVE_SCREEN in running.output
    assert SHOW_CURSOR in running.output


@pytest.mark.machine
def test_a_terminal_that_goes_ends_the_console_soon(running: Terminal) -> None:
    running.hang_up()
    assert running.wait_exit(10.0) == 128 + signal.SIGHUP


@pytest.mark.machine
def test_a_signal_ends_the_console_even_if_its_terminal_takes_nothing(running: Terminal) -> None:
    time.sleep(6.0)  # nobody reads: the pty and the queue before it fill up
    os.kill(running.pid, signal.SIGHUP)
    assert running.wait_exit_unread(8.0) == 128 + signal.SIGHUP


@pytest.mark.machine
def test_a_size_in_the_environment_decides_nothing() -> None:
    with console(COLUMNS="40", LINES="10") as terminal:
        assert terminal.screen()[-1].endswith(LAST_KEY)


@pytest.mark.machine
def test_the_error_output_may_go_elsewhere(tmp_path: Path) -> None:
    errors = tmp_path / "errors"
    command = f"exec {shlex.join(PROGRAM)} 2>{shlex.quote(str(errors))}"
    with console(["sh", "-c", command]) as terminal:
        terminal.send(F10)
        assert terminal.wait_exit() == 0
        assert LEAVE_SCREEN in terminal.output
    assert errors.read_bytes() == b""


@pytest.mark.machine
@pytest.mark.parametrize("term", ["dumb", "", "unknown"])
def test_a_terminal_that_cannot_show_screens_is_refused(term: str) -> None:
    with pytest.raises(MadrobError, match="`madrob run` prints plain lines"):
        check_terminal({"TERM": term} if term else {})


@pytest.mark.machine
@pytest.mark.parametrize("term", ["xterm-256color", "tmux-256color", "screen", "linux", "vt100"])
def test_other_terminals_are_not(term: str) -> None:
    check_terminal({"TERM": term})


@pytest.mark.machine
@pytest.mark.parametrize(
    "module", ["madrob_console.ui.terminal", "madrob_console.engine.ipc.client"]
)
def test_the_screens_import_nothing_slow(module: str) -> None:
    slow = {"scipy", "pandas", "rclpy", "numpy", "rosbags"}
    code = f"import sys, {module};print(*{{m.partition('.')[0] for m in sys.modules}} & {slow})"
    output = subprocess.check_output([sys.executable, "-c", code], cwd=ROOT, text=True)
    assert output.strip() == ""


@pytest.mark.machine
@pytest.mark.slow
@pytest.mark.parametrize(
    ("argv", "columns", "lines", "most"),
    [
        (CONSOLE, 80, 24, 8_000),
        (CONSOLE, 120, 36, 15_000),
        (CONSOLE, 160, 50, 25_000),
        (PROGRAM, 80, 24, 1_000),
    ],
    ids=["a live run", "a larger one", "a very large one", "at rest"],
)
def test_the_screens_are_light_on_the_line(
    argv: Sequence[str], columns: int, lines: int, most: float
) -> None:
    with console(argv, columns, lines) as terminal:
        assert bytes_per_second(terminal, 6.0) <= most


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


@pytest.mark.machine
@pytest.mark.needs("tmux")
@pytest.mark.parametrize("end", [[], ["env", "-u", "TMUX"]], ids=["here", "over SSH"])
def test_y_copies_into_a_tmux_that_lets_it(tmp_path: Path, end: list[str]) -> None:
    ends = tmp_path / "ends"
    ends.touch()
    with Tmux([*end, *CONSOLE, str(ends)], cwd=ROOT) as tmux:
        tmux.set_option("set-clipboard", "on")
        tmux.wait_for("The result is written", timeout=STARTING)
        for key in ("Enter", "y"):
            time.sleep(HUMAN)
            tmux.press(key)
        tmux.wait_for("the run's folder")
        tmux.press("p")
        tmux.wait_for("Copied, if tmux has `set-clipboard on`")
        assert tmux.buffer() == FOLDER
