"""A fault at each call by which a command changes files: nothing is lost, the next go ends it."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.archive.history import History
from madrob_console.referee.journal import read_journal
from recorder.listing import put_listing
from recorder.reader import Bag
from tests.madrob_console.recorded_runs import completed, final
from tests.madrob_console.whole.test_every_call import (
    ALL_FROM,
    SHARES,
    Call,
    Trap,
    library,  # noqa: F401  a fixture
    share_of_this_commit,
)
from tests.recorder.samples import add_evidence, strings

pytestmark = [pytest.mark.needs("cc", "/usr/include/stdio.h"), pytest.mark.slow]

FAULTS = ("process killed", "EIO", "ENOSPC")


class Madrob:
    """Does commands in forks of one warm process."""

    def __init__(self, preloaded: Path, folder: Path) -> None:
        self._log = folder / "log"
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.madrob_console.forking_madrob"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={
                "LD_PRELOAD": str(preloaded),
                "HOME": str(folder),
                "PATH": "/usr/bin:/bin",
            },
        )

    def run(self, arguments: list[str], trap: Trap) -> int:
        self._log.write_text("")
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        question = {"arguments": arguments, "environment": trap.environment, "log": str(self._log)}
        self._process.stdin.write(json.dumps(question) + "\n")
        self._process.stdin.flush()
        return int(self._process.stdout.readline())

    @property
    def said(self) -> str:
        return self._log.read_text()

    def close(self) -> None:
        self._process.communicate()


@pytest.fixture
def madrob(library: Path, tmp_path: Path) -> Iterator[Madrob]:  # noqa: F811
    started = Madrob(library, tmp_path)
    yield started
    started.close()


def lost_table(results: Path) -> None:
    next((results / "practice").glob("*/*_wrench.csv")).unlink()


def torn_recording(results: Path) -> None:
    """As a kill leaves it: without its end."""
    for path in (results / "practice").glob("*/*_0.mcap"):
        with path.open("r+b") as file:
            file.truncate(path.stat().st_size - 100)


def damaged_result(results: Path) -> None:
    for path in results.glob(f"practice/*/{RESULT_FILE}"):
        path.write_text(path.read_text().replace('"level"', '"lever"', 1))


def with_evidence(results: Path) -> None:
    for folder in (results / "practice").iterdir():
        if folder.is_dir():
            add_evidence(folder, strings(["a picture", "another"]))
            number = os.open(folder, os.O_DIRECTORY)
            put_listing(number)
            os.close(number)


def nothing(_results: Path) -> None:
    pass


@dataclass(frozen=True, slots=True)
class Command:
    """A command line, what was done to its runs before, and whether it may change results."""

    words: str
    spoil: Callable[[Path], None] = nothing
    next_issue: bool = False

    def arguments(self, results: Path) -> list[str]:
        places = {"RESULTS": str(results), "OUT": str(results / "out")}
        return [re.sub("RESULTS|OUT", lambda m: places[m[0]], word) for word in self.words.split()]


COMMANDS = {
    "recover a lost table": Command("recover RESULTS", lost_table),
    "recover a torn recording": Command("recover RESULTS", torn_recording),
    "recover a damaged result": Command("recover RESULTS", damaged_result),
    "re-issue": Command("score --reissue rules --ruleset eurobench-2020 RESULTS", next_issue=True),
    "report": Command("report RESULTS"),
    "publish": Command("publish --practice --results RESULTS OUT"),
    "export": Command("export --practice --results RESULTS --subject 3 --output OUT.zip"),
    "table": Command("table runs RESULTS --output OUT.csv"),
    "tidy": Command("tidy --keep-runs 0 --yes --results RESULTS", with_evidence),
}


def archive(folder: Path, command: Command) -> Path:
    results = folder / "results"
    shutil.rmtree(results, ignore_errors=True)
    for run in (final(), completed(2)):
        shutil.copytree(run, results / "practice" / run.name)
    command.spoil(results)
    return results


def files_of(results: Path) -> set[str]:
    """Names of all files but for locks, of which an empty file may stay."""
    files = (path for path in results.rglob("*") if path.is_file() and path.suffix != ".lock")
    return {str(path.relative_to(results)) for path in files}


def results_of(results: Path) -> dict[str, Any]:
    """The stored results, without the times at which they were made."""
    found = {}
    for path in sorted(results.glob(f"practice/*/{RESULT_FILE[:-5]}*.json")):
        document = json.loads(path.read_text())
        kept = ("issue", "closure", "outcome", "indicators", "steps", "events", "ruleset")
        found[str(path.relative_to(results))] = {name: document[name] for name in kept}
    return found


def what_is_wrong(results: Path, clean: Path, before: dict[str, Any]) -> Iterator[str]:
    """After a fault: what was issued is there, as it was or as the command makes it."""
    after = results_of(clean)
    for name, stored in results_of(results).items():
        if stored not in (before.get(name), after.get(name)):
            yield f"{name} is neither as before nor as after"
    for name in before:
        if not (results / name).exists():
            yield f"{name} is gone"
    for folder in (results / "practice").glob("subject_*"):
        if not read_journal(folder / JOURNAL_FILE)[0]:
            yield f"{folder.name}: its journal is gone"
        if not any(True for _ in Bag(folder).messages()):
            yield f"{folder.name}: its recording is gone"
    if len(History(results).refresh()) != 2:
        yield "a run is not listed"


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("name", COMMANDS)
def test_a_fault_at_any_call_of_a_command_loses_nothing_and_is_mended_by_the_next_go(
    name: str, fault: str, madrob: Madrob, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    command = COMMANDS[name]
    clean = archive(tmp_path / "clean", command)
    notes = tmp_path / "notes"
    notes.mkdir()
    trap = Trap(tmp_path, clean, notes)
    assert madrob.run(command.arguments(clean), trap) == 0, madrob.said
    before = results_of(archive(tmp_path / "before", command))
    expected = files_of(clean)
    assert not {name for name in expected if name.endswith(".part")}
    chosen = [call for call in trap.calls() if call.can_have(fault) and call.name != "look"]
    count = len(chosen)
    if request.config.getoption("--runs") < ALL_FROM:
        chosen = chosen[share_of_this_commit(min(SHARES, count)) :: SHARES]
    wrong: list[tuple[Call, str]] = []
    came = 0
    for call in chosen:
        results = archive(tmp_path / "tried", command)
        trap = Trap(tmp_path, results, notes, fault, call)
        code = madrob.run(command.arguments(results), trap)
        came += trap.came_at() is not None
        wrong += [(call, words) for words in what_is_wrong(results, clean, before)]
        if "Traceback" in madrob.said:
            wrong.append((call, madrob.said))
        if code == 0 and trap.came_at() is not None and files_of(results) != expected:
            wrong.append((call, f"all is well, it says, but {files_of(results) ^ expected}"))
        if command.next_issue:  # what is journalled is made by `recover`, else it is tried again
            madrob.run(["recover", str(results)], Trap(tmp_path, results, notes))
        if madrob.run(command.arguments(results), Trap(tmp_path, results, notes)) != 0:
            wrong.append((call, f"the next go: {madrob.said}"))
        if results_of(results) != results_of(clean):
            wrong.append((call, "the next go gives other results"))
        if more := files_of(results) ^ expected:
            wrong.append((call, f"left or missing after the next go: {more}"))
    print(f"\n{name}, {fault}: {came} of {count} calls")
    assert wrong == []
    if len(chosen) == count:  # of one alone the temporary name may be of another length
        assert came > 0.5 * count
