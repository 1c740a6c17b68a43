"""Work beside the engine: one process at a time, and none while a run goes on."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import cast

import pytest

from madrob_console.archive.scored import Scored
from madrob_console.cli import aside
from madrob_console.engine.process import background
from madrob_console.engine.process.background import Background, Finished
from madrob_console.engine.process.reporting import Reporting
from madrob_console.engine.shown.snapshot import ExportView
from madrob_console.files.whole import whole_file
from tests.watching import PATIENCE, until

pytestmark = pytest.mark.machine

BEGIN = """
import signal, sys
from madrob_console.cli import aside
signal.signal(signal.SIGTERM, aside._end)
exec(sys.argv.pop(1))
"""

SLOW = """
import sys, time
from madrob_console.files.whole import whole_file
from pathlib import Path
with whole_file(Path(sys.argv[1])) as file:
    file.write(b"half")
    file.flush()
    Path(sys.argv[1] + ".begun").touch()
    time.sleep(60)
"""

UNTIL_TOLD = """
import sys, time
from pathlib import Path
Path(sys.argv[1]).touch()
while not Path(sys.argv[2]).exists():
    time.sleep(0.01)
"""


class Hall:
    """A run goes on or not; what came of the chores."""

    def __init__(self, command: Sequence[str] = aside.COMMAND) -> None:
        self.busy = False
        self.done: list[tuple[str, Finished]] = []
        self.background = Background(command, lambda: self.busy)

    def ask(self, name: str, *arguments: str) -> None:
        self.background.ask(name, arguments, lambda finished: self.done.append((name, finished)))

    @property
    def names(self) -> list[str]:
        return [name for name, _ in self.done]


@pytest.fixture
def hall() -> Iterator[Hall]:
    hall = Hall()
    yield hall
    hall.background.close(PATIENCE)


@pytest.fixture
def quick_hall() -> Iterator[Hall]:
    """Its chores are no `madrob`, to be quick: python code and its arguments."""
    hall = Hall((sys.executable, "-c", BEGIN))
    yield hall
    hall.background.close(PATIENCE)


def test_a_chore_comes_after_everything_else() -> None:
    code = "import atexit, os, sys; atexit.register(lambda: print(os.nice(0)));"
    code += "from madrob_console.cli import aside; sys.exit(aside.main())"
    told = subprocess.run(
        [sys.executable, "-c", code, "--version"], capture_output=True, text=True, check=True
    )
    assert told.stdout.splitlines()[-1] == str(min(19, os.nice(0) + aside.NICENESS))


def test_a_chore_is_a_madrob_command(hall: Hall) -> None:
    hall.ask("version", "--version")
    hall.ask("bad", "export", "--team=zero")
    assert hall.background.wait(PATIENCE)
    (_, good), (_, bad) = hall.done
    assert good.code == 0
    assert good.said.startswith("madrob ")
    assert bad.code == 2
    assert "zero" in bad.complained


def test_what_is_asked_for_again_before_it_begins_is_done_once(quick_hall: Hall) -> None:
    quick_hall.busy = True
    for number in range(5):
        quick_hall.ask("report", f"print({number})")
    quick_hall.ask("zip", "print('zip')")
    time.sleep(3 * background.PERIOD)
    assert quick_hall.done == []
    quick_hall.busy = False
    assert quick_hall.background.wait(PATIENCE)
    assert [(name, finished.said) for name, finished in quick_hall.done] == [
        ("report", "4"),
        ("zip", "zip"),
    ]


def test_what_is_asked_for_while_it_is_done_is_done_once_more(
    quick_hall: Hall, tmp_path: Path
) -> None:
    begun, may_end = tmp_path / "begun", tmp_path / "may end"
    quick_hall.ask("report", UNTIL_TOLD, str(begun), str(may_end))
    until(begun.exists)
    quick_hall.ask("report", "print('second')")
    quick_hall.ask("report", "print('third')")
    may_end.touch()
    assert quick_hall.background.wait(PATIENCE)
    assert [finished.said for _, finished in quick_hall.done] == ["", "third"]


def test_a_run_cuts_a_chore_short_which_leaves_nothing_and_is_done_again_after_it(
    quick_hall: Hall, tmp_path: Path
) -> None:
    target = tmp_path / "report.html"
    begun = tmp_path / "report.html.begun"
    quick_hall.ask("report", SLOW, str(target))
    until(begun.exists)
    assert len(list(tmp_path.iterdir())) == 2  # the file has another name still
    quick_hall.busy = True
    until(lambda: list(tmp_path.iterdir()) == [begun])
    begun.unlink()
    assert quick_hall.done == []
    quick_hall.ask("report", "print('after the run')")
    time.sleep(3 * background.PERIOD)
    assert quick_hall.done == []
    quick_hall.busy = False
    assert quick_hall.background.wait(PATIENCE)
    assert [finished.said for _, finished in quick_hall.done] == ["after the run"]


def test_a_process_that_cannot_be_started_is_told_in_words() -> None:
    reporting = Reporting(["/no/such/python"], lambda: False)
    reporting.report(Path("/results/run"), cast(Scored, "a result"))
    reporting.export(3)
    assert reporting.wait(PATIENCE)
    assert reporting.problem is not None
    assert "no report of run: no process could be started" in reporting.problem
    assert reporting.exported is not None
    assert "no process could be started" in reporting.exported.problem
    reporting.close(PATIENCE)


def test_a_zip_that_cannot_be_made_is_told_in_a_line(tmp_path: Path) -> None:
    reporting = Reporting(aside.COMMAND, lambda: False, [f"--results={tmp_path}"])
    reporting.export(3)
    assert reporting.exported == ExportView(3)
    reporting.close(PATIENCE)
    assert reporting.problem is None
    assert reporting.exported is not None
    assert reporting.exported.path == ""
    assert "team 3 has no runs" in reporting.exported.problem


def test_a_file_that_is_cut_short_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), whole_file(tmp_path / "a") as file:  # noqa: PT012
        file.write(b"half")
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []
