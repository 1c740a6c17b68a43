"""The command of [results], which an engine calls after each result."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from madrob_console.engine.runtime.reports import WantedPages
from tests.madrob_console.engine.reporting import reporting_on, told_of
from tests.madrob_console.recorded_runs import completed
from tests.watching import alive, children_of, until

pytestmark = pytest.mark.machine

RUN_ALONE = """
import sys
from madrob_console.cli.guarded import guarded, run_command
sys.exit(guarded(lambda: run_command(sys.argv[2:], float(sys.argv[1]))))
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Of a run among the results."""
    return Path(shutil.copytree(completed(), tmp_path / "runs" / completed().name))


def log_of(text: str) -> list[str]:
    """The lines of a log, without their times."""
    return [re.sub(r"after [0-9.]+ s", "after N s", line) for line in text.splitlines()]


def numbers_in(file: Path, count: int) -> list[int]:
    """The first numbers of processes that a script has written down, once they are there."""

    def written() -> list[str]:
        lines = file.read_text().split() if file.exists() else []
        return lines if len(lines) >= count else []

    return [int(line) for line in (until(written) or [])[:count]]


def script(tmp_path: Path, *lines: str) -> tuple[str, ...]:
    path = tmp_path / "after_result"
    path.write_text("\n".join(("#!/bin/sh", *lines, "")))
    path.chmod(0o755)
    return str(path), "--hall", "3"


def test_the_command_of_the_settings_follows_every_result(
    folder: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    told = tmp_path / "told"
    command = script(tmp_path, f'echo "$@" >> {told}', "echo sent; echo not quite >&2")
    with reporting_on(folder.parent, WantedPages(reports=False, command=command)) as reporting:
        for _ in range(2):
            reporting.report(folder)
            assert reporting.wait(60.0)
        assert reporting.problem is None
    assert told.read_text().splitlines() == [f"--hall 3 {folder}"] * 2
    lines = ("sent", "not quite", "after_result: exit code 0 after N s")
    assert log_of(capfd.readouterr().err) == [f"command of [results]: {line}" for line in 2 * lines]


@pytest.mark.parametrize(
    ("lines", "problem"),
    [
        (("echo no network", "exit 3"), "after_result ended with code 3: no network"),
        (("exit 75",), "after_result ended with code 75: it said nothing; it is tried again"),
        (("kill -TERM $$",), "after_result ended with code -15: it said nothing"),
        ((), "after_result: No such file or directory"),
    ],
    ids=["fails", "later", "ended", "missing"],
)
def test_a_command_that_fails_is_named_in_one_line(
    lines: tuple[str, ...], problem: str, tmp_path: Path
) -> None:
    command = script(tmp_path, *lines)
    if not lines:
        Path(command[0]).unlink()
    with reporting_on(tmp_path, WantedPages(reports=False, command=command)) as reporting:
        reporting.report(completed())
        told = told_of(reporting, "the command of [results] failed: ")
        assert told.endswith(problem)
        script(tmp_path, "exit 0")
        reporting.report(completed())
        until(lambda: reporting.problem is None)


@pytest.mark.parametrize(
    ("does", "code"),
    [
        ("sleep 1000", -15),
        ("yes", -15),
        ("exec >/dev/null 2>&1; sleep 1000", -15),
        ("trap '' TERM; sleep 1000; sleep 1000", -9),
    ],
    ids=["hangs", "floods", "mute", "stubborn"],
)
def test_a_command_that_does_not_end_is_ended_with_all_it_started(
    does: str, code: int, tmp_path: Path
) -> None:
    begun = tmp_path / "begun"
    command = script(tmp_path, "setsid sleep 1000 &", f"echo $$ $! > {begun}", does)
    arguments = [sys.executable, "-c", RUN_ALONE, "1", *command]
    ended = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    *lines, told = log_of(ended.stderr)
    assert told == "madrob: after_result was ended: its time of 1 s was over"
    how = f"after_result: exit code {code} after N s: its time of 1 s was over"
    printed = ["y"] * (len(lines) - 1)
    assert lines == [f"command of [results]: {line}" for line in (*printed, how)]
    assert (len(printed) > 9000) is (does == "yes")
    assert not any(map(alive, numbers_in(begun, 2)))


def test_a_command_ends_with_its_process_and_so_does_all_it_started(
    folder: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Who keeps its output or has a session of its own is not waited for."""
    begun = tmp_path / "begun"
    command = script(
        tmp_path,
        "sleep 1000 &",
        f"echo $! >> {begun}",
        f"(setsid sh -c 'echo $$ >> {begun}; setsid sleep 1000 & echo $! >> {begun}; wait') &",
        f"while [ $(wc -l < {begun}) -lt 3 ]; do sleep 0.01; done",
    )
    with reporting_on(folder.parent, WantedPages(reports=False, command=command)) as reporting:
        reporting.report(folder)
        assert reporting.wait(30.0)
        assert reporting.problem is None
        assert not any(map(alive, numbers_in(begun, 3)))
    line = "command of [results]: after_result: exit code 0 after N s"
    assert log_of(capfd.readouterr().err) == [line]


@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.parametrize("which", ["outer", "inner"])
def test_a_command_ends_with_the_processes_that_watch_it(
    which: str, sent: signal.Signals, folder: Path, tmp_path: Path
) -> None:
    begun = tmp_path / "begun"
    command = script(
        tmp_path, f"echo $$ >> {begun}", f"setsid sleep 1000 & echo $! >> {begun}", "wait"
    )
    wanted = WantedPages(reports=False, command=command)
    with reporting_on(folder.parent, wanted) as reporting:
        reporting.report(folder)
        first = numbers_in(begun, 2)
        outer = until(lambda: reporting.workers[1].pid)
        assert outer is not None
        (inner,) = children_of(outer)
        os.kill(outer if which == "outer" else inner, sent)
        until(lambda: not any(map(alive, first)))
        again = numbers_in(begun, 4)[2:]  # it is called again, and a run ends it
        until(lambda: not any(map(alive, (outer, inner))))
        reporting.hold(held=True)
        until(lambda: not any(map(alive, again)))


def test_nothing_waits_for_a_command_that_hangs_and_a_run_ends_it(
    folder: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    begun = tmp_path / "begun"
    command = script(tmp_path, f"setsid sleep 1000 & echo $! >> {begun}", "sleep 1000")
    wanted = WantedPages(options=[f"--results={folder.parent}"], command=command)
    with reporting_on(folder.parent, wanted) as reporting:
        reporting.report(folder)
        until((folder / "report.html").exists)
        hangs = int(until(lambda: begun.exists() and begun.read_text()) or 0)
        reporting.export(3, practice=True)
        until(lambda: reporting.exported is not None and reporting.exported.path)
        assert alive(hangs)
        assert reporting.problem is None
        reporting.hold(held=True)
        until(lambda: not alive(hangs))
        told = until(lambda: log_of(capfd.readouterr().err))
        assert "after_result: exit code -9 after N s: a run begins" in str(told)
        reporting.hold(held=False)
        until(lambda: len(begun.read_text().split()) == 2)  # it is called again
        reporting.hold(held=True)
