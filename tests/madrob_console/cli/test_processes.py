"""What only a process shows: signals, closed pipes, full disks, imports, and TAB in real shells."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import IO

import pytest

from madrob_console.cli import settings_command
from madrob_console.cli.interruption import STOPPED, interruptible
from madrob_console.cli.main import main
from madrob_console.common.names import Scenario
from tests.madrob_console.recorded_runs import recorded
from tests.slowly import slow_but_for

PROGRAM = (sys.executable, "-m", "madrob_console.cli")


def ran(*command: str, **how: object) -> subprocess.CompletedProcess[str]:
    usual = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.run(command, text=True, check=False, **{**usual, **how})  # type: ignore[call-overload,no-any-return]


IMPORTS = {
    "no help text waits for a large library": (
        "asyncio matplotlib mcap msgspec numpy pandas rclpy textual",
        "from madrob_console.cli.main import build_parser; build_parser()",
    ),
    "what nothing is painted of yet is imported after the first paint": (
        "madrob_console.engine.snapshot madrob_console.archive.run_journal",
        """
import madrob_console.ui.terminal as terminal
terminal.check_terminal = lambda *_: None
terminal.run_console = lambda *_, **__: 0
from madrob_console.cli.main import main
main(['console', '--testbed', 'simulated', '--results', sys.argv[1]])
""",
    ),
}


@pytest.mark.machine
@pytest.mark.parametrize("what", IMPORTS)
def test_imports_wait(what: str, tmp_path: Path) -> None:
    late, code = IMPORTS[what]
    told = f"import sys\n{code}\nprint({set(late.split())} & set(sys.modules))"
    home = os.environ | {"HOME": str(tmp_path)}
    assert ran(sys.executable, "-c", told, str(tmp_path), env=home).stdout == "set()\n"


@pytest.mark.machine
@pytest.mark.parametrize("command", ["settings", "guide", "--help"])
def test_a_full_disk_behind_the_output_is_one_line(command: str) -> None:
    with Path("/dev/full").open("w") as full:
        done = ran(*PROGRAM, command, stdout=full)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "the output cannot be written (No space left on device)" in done.stderr


@pytest.mark.machine
@pytest.mark.parametrize(("command", "lines"), [("console", "run"), ("watch", "watch --plain")])
def test_screens_are_not_painted_into_a_pipe(command: str, lines: str, tmp_path: Path) -> None:
    done = ran(*PROGRAM, command, "--results", str(tmp_path))
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith(f"madrob: no terminal: `madrob {lines}` prints plain lines")


STARTS = 3
"""A machine that stutters for half a second may have a start refused: the sensors seem silent."""


def begun_run(results: Path) -> subprocess.Popen[str]:
    """Start `madrob run` until a run begins."""
    line = ["run", "--testbed", "simulated", "--countdown", "1", "--no-report", "--results"]
    for _ in range(STARTS):
        process = subprocess.Popen(
            (*PROGRAM, *line, str(results)), stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        for said in process.stdout:
            if "run starts" in said:
                return process
        assert process.wait() == 2
        process.stdout.close()
    raise AssertionError("no start was accepted")


@pytest.mark.machine
@pytest.mark.parametrize(
    "number", slow_but_for([signal.SIGINT, signal.SIGTERM, signal.SIGHUP], signal.SIGTERM)
)
def test_a_signal_aborts_the_run_and_keeps_it_on_record(
    number: signal.Signals, tmp_path: Path
) -> None:
    with begun_run(tmp_path) as process:
        assert process.stdout is not None
        process.send_signal(number)
        *_, last = process.stdout
    stored = json.loads(Path(last.strip().removeprefix("run folder: "), "result.json").read_text())
    told = process.returncode, stored["outcome"], number.name in stored["outcome_reason"]
    assert told == (4, "aborted", True)


# Ctrl+C, at whatever moment: one line, nothing half made, exit code 130 (as shells have it).


RUNS = 12
EARLIEST = 0.3  # s: by then python has begun with this program, also on a busy machine
LATEST = 4.0
SAID = (-signal.SIGINT, "madrob: stopped\n")


@pytest.fixture
def results(tmp_path: Path) -> Path:
    for number in range(1, RUNS + 1):
        name = f"subject_001_cond_001_run_{number:03d}_20260321_1000{number:02d}"
        shutil.copytree(recorded(Scenario.NOMINAL), tmp_path / "results" / name)
    return tmp_path / "results"


def interrupted(arguments: Sequence[str], begun: Callable[[IO[str]], object]) -> tuple[int, str]:
    """The return code and what was said, if it was not over before; nobody who works for it stays.

    `begun` may read what it prints.
    """
    with subprocess.Popen(
        [*PROGRAM, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        while process.poll() is None and not begun(process.stdout):
            time.sleep(0.005)
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGINT)  # all of it hears, as from a terminal
        _, error = process.communicate(timeout=40)
    while there(process.pid):  # within the minute that a test has
        time.sleep(0.01)
    return process.returncode, error


def there(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def commands(results: Path) -> dict[str, list[str]]:
    folder = str(results)
    runs = [*map(str, results.glob("subject*"))]
    return {
        "score": ["score", folder],
        "check": ["score", "--check", "--jobs", "2", folder],
        "report": ["report", folder, "--output", str(results.parent / "pages")],
        "export": ["export", "--subject", "1", "--results", folder],
        "recover": ["recover", *runs],
        "calibrate": ["calibrate", "masks", runs[0]],
        "standings": ["standings", "--practice", "--results", folder],
    }


def half_made(results: Path) -> list[Path]:
    files = list(results.parent.rglob("*"))
    parts = [path for path in files if path.name.endswith(".part")]
    return parts + [path for path in files if path.suffix == ".zip" and not whole(path)]


def whole(zip_file: Path) -> bool:
    try:
        return zipfile.ZipFile(zip_file).testzip() is None
    except zipfile.BadZipFile:
        return False


@pytest.mark.machine
@pytest.mark.parametrize(
    ("command", "made"),
    [("report", "pages/*"), ("export", "results/exports"), ("check", ""), ("score", "")],
)
def test_ctrl_c_prints_one_line_and_leaves_nothing_half_made_and_nobody_behind(
    command: str, made: str, results: Path
) -> None:
    def part_way(out: IO[str]) -> object:
        return any(results.parent.glob(made)) if made else out.readline()

    assert interrupted(commands(results)[command], part_way) == SAID
    assert half_made(results) == []
    assert not (results / "exports").exists()


@pytest.mark.slow
@pytest.mark.machine
def test_ctrl_c_at_any_moment(results: Path, request: pytest.FixtureRequest) -> None:
    runs = request.config.getoption("--runs")
    moments = random.Random(runs)
    stopped = 0
    for _ in range(runs):
        for arguments in commands(results).values():
            after = moments.uniform(EARLIEST, LATEST)
            at = time.monotonic() + after
            said = interrupted(arguments, lambda _, at=at: time.monotonic() > at)  # type: ignore[misc]
            if said[0] == -signal.SIGINT:
                stopped += 1
                assert said == SAID, (arguments, after)
                assert half_made(results) == []
            assert "Traceback" not in said[1], (arguments, after)
    assert stopped >= runs


class Finalised:
    """Nothing can catch an interrupt while it is finalised: it comes again."""

    def __del__(self) -> None:
        raise KeyboardInterrupt


def lost_in_a_finaliser() -> None:
    with interruptible():
        Finalised()
        while True:  # within the minute that a test has
            time.sleep(0.001)


@contextmanager
def restored_ctrl_c() -> Iterator[None]:
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.machine
def test_a_ctrl_c_that_nothing_can_catch_comes_again() -> None:
    with restored_ctrl_c():
        signal.signal(signal.SIGINT, signal.default_int_handler)
        with pytest.raises(KeyboardInterrupt):
            lost_in_a_finaliser()


@pytest.mark.parametrize("pressed", [True, False])
def test_ctrl_c_is_its_exit_code_and_of_what_it_left_unfinished_nothing_is_said(
    pressed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    def packs(_arguments: object) -> int:
        with (tmp_path / "some.zip").open("wb") as file:
            unfinished = zipfile.ZipFile(file, "w")
            if pressed:
                signal.raise_signal(signal.SIGINT)
        del unfinished  # which cannot be closed without its file, and python says so
        return 0

    monkeypatch.setattr(
        settings_command, "settings", replace(settings_command.settings, main=packs)
    )
    with restored_ctrl_c():
        assert main(["settings"]) == (STOPPED if pressed else 0)
    said = capsys.readouterr().err
    assert said.count("ZipFile.__del__") == (not pressed)
    assert said == "madrob: stopped\n" or not pressed
