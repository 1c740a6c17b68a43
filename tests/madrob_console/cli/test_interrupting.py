"""Ctrl+C, at whatever moment: one line, nothing half made, exit code 130 (as shells have it)."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from madrob_console.cli import schema_command
from madrob_console.cli.main import main
from madrob_console.cli.output import STOPPED, interruptible
from madrob_console.common.names import Scenario
from tests.madrob_console.recorded_runs import recorded

PROGRAM = (sys.executable, "-m", "madrob_console.cli")
RUNS = 12
EARLIEST = 0.3  # s: by then python has begun with this program, also on a busy machine
LATEST = 4.0


@pytest.fixture
def results(tmp_path: Path) -> Path:
    root = tmp_path / "results"
    for number in range(1, RUNS + 1):
        name = f"subject_001_cond_001_run_{number:03d}_20260321_1000{number:02d}"
        shutil.copytree(recorded(Scenario.NOMINAL), root / name)
    return root


def interrupted(arguments: list[str], begun: Callable[[], bool]) -> tuple[int, str]:
    """The return code and what was said, if it was not over before."""
    with subprocess.Popen(
        [*PROGRAM, *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    ) as process:  # fmt: skip
        while process.poll() is None and not begun():
            time.sleep(0.005)
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGINT)  # all of it hears, as from a terminal
        _, error = process.communicate(timeout=40)
    return process.returncode, error


class Finalised:
    """Nothing can catch an interrupt while it is finalised: it comes again."""

    def __del__(self) -> None:
        raise KeyboardInterrupt


def lost_in_a_finaliser() -> None:
    with interruptible():
        Finalised()
        while True:  # within the minute that a test has
            time.sleep(0.001)


@pytest.mark.machine
def test_an_alarm_that_was_set_before_a_command_still_comes_to_who_set_it() -> None:
    class AlarmError(Exception):
        pass

    def ring(_number: int, _frame: object) -> None:
        raise AlarmError

    own = signal.setitimer(signal.ITIMER_REAL, 50.0)  # by which a test counts as hanging
    limit = signal.signal(signal.SIGALRM, ring)
    try:
        with restored_ctrl_c():
            signal.signal(signal.SIGINT, signal.default_int_handler)
            with pytest.raises(KeyboardInterrupt):
                lost_in_a_finaliser()
            left, _ = signal.getitimer(signal.ITIMER_REAL)
            assert 30.0 < left <= 50.0
            with pytest.raises(AlarmError), interruptible():
                signal.raise_signal(signal.SIGALRM)
    finally:
        signal.signal(signal.SIGALRM, limit)
        signal.setitimer(signal.ITIMER_REAL, *own)


@contextmanager
def restored_ctrl_c() -> Iterator[None]:
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def there(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


def commands(results: Path) -> list[list[str]]:
    folder = str(results)
    one = str(next(results.glob("subject*")))
    return [
        ["score", folder],
        ["score", "--check", "--jobs", "2", folder],
        ["report", folder, "--output", str(results.parent / "pages")],
        ["export", "--subject", "1", "--results", folder],
        ["recover", *map(str, results.glob("subject*"))],
        ["calibrate", "masks", one],
        ["standings", "--practice", "--results", folder],
    ]


def half_made(results: Path) -> list[Path]:
    files = list(results.parent.rglob("*"))
    parts = [path for path in files if path.name.endswith(".part")]
    return parts + [path for path in files if path.suffix == ".zip" and not whole(path)]


def whole(zip_file: Path) -> bool:
    try:
        return zipfile.ZipFile(zip_file).testzip() is None
    except zipfile.BadZipFile:
        return False


def part_way(results: Path, command: str) -> Callable[[], bool]:
    """Whether something of what the command makes is there."""
    made = results.parent / "pages" if command == "report" else results / "exports"
    return lambda: made.is_dir() and any(made.iterdir())


@pytest.mark.machine
@pytest.mark.parametrize("command", ["report", "export"])
def test_ctrl_c_prints_one_line_and_leaves_nothing_half_made(command: str, results: Path) -> None:
    (arguments,) = (words for words in commands(results) if words[0] == command)
    code, error = interrupted(arguments, part_way(results, command))
    assert (code, error) == (-signal.SIGINT, "madrob: stopped\n")
    assert half_made(results) == []
    assert not (results / "exports").exists()


@pytest.mark.machine
@pytest.mark.parametrize("options", [[], ["--check", "--jobs", "2"]])
def test_ctrl_c_ends_those_who_work_for_it_in_silence(options: list[str], results: Path) -> None:
    with subprocess.Popen(
        [*PROGRAM, "score", *options, str(results)], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, start_new_session=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        assert process.stdout.readline()
        os.killpg(process.pid, signal.SIGINT)
        _, error = process.communicate(timeout=40)
    assert (process.returncode, error) == (-signal.SIGINT, "madrob: stopped\n")
    while there(process.pid):  # within the minute that a test has
        time.sleep(0.01)


@pytest.mark.slow
@pytest.mark.machine
def test_ctrl_c_at_any_moment(results: Path, request: pytest.FixtureRequest) -> None:
    runs = request.config.getoption("--runs")
    moments = random.Random(runs)
    stopped = 0
    for _ in range(runs):
        for arguments in commands(results):
            after = moments.uniform(EARLIEST, LATEST)
            at = time.monotonic() + after
            code, error = interrupted(arguments, lambda at=at: time.monotonic() > at)  # type: ignore[misc]
            if code == -signal.SIGINT:
                stopped += 1
                assert error == "madrob: stopped\n", (arguments, after)
                assert half_made(results) == []
            else:
                assert "Traceback" not in error, (arguments, after)
    assert stopped >= runs


@pytest.mark.parametrize(("pressed", "complaints"), [(True, 0), (False, 1)])
def test_of_what_ctrl_c_left_unfinished_nothing_is_said(
    pressed: bool,
    complaints: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def packs(_arguments: object) -> int:
        with (tmp_path / "some.zip").open("wb") as file:
            unfinished = zipfile.ZipFile(file, "w")
            if pressed:
                signal.raise_signal(signal.SIGINT)
        del unfinished  # which cannot be closed without its file, and python says so
        return 0

    monkeypatch.setattr(schema_command, "schema", replace(schema_command.schema, main=packs))
    with restored_ctrl_c():
        main(["schema"])
    said = capsys.readouterr().err
    assert said.count("ZipFile.__del__") == complaints
    assert said.startswith("madrob: stopped\n") == pressed


def test_ctrl_c_in_a_command_is_its_exit_code(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def pressed(_arguments: object) -> int:
        signal.raise_signal(signal.SIGINT)
        time.sleep(0)
        return 0

    monkeypatch.setattr(schema_command, "schema", replace(schema_command.schema, main=pressed))
    with restored_ctrl_c():
        assert main(["schema"]) == STOPPED
    assert capsys.readouterr().err == "madrob: stopped\n"
