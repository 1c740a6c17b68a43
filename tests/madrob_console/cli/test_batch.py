"""The same work on many things: in order, wherever it is done."""

from __future__ import annotations

import os
import shutil
import signal
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import joblib
import pytest

from madrob_console.cli.batch import WORTH_A_PROCESS, in_order
from madrob_console.cli.main import main
from madrob_console.common.errors import MadrobError
from tests.madrob_console.archive.frames import film
from tests.madrob_console.recorded_runs import completed
from tests.watching import PATIENCE


class SlowerFirst:
    """The first is not done before another one is, where they are done side by side."""

    def __init__(self) -> None:
        self._another = threading.Event()

    def __call__(self, number: int) -> int:
        if number > 0:
            self._another.set()
        elif threading.current_thread() is not threading.main_thread():
            assert self._another.wait(PATIENCE)
        return -number


def die(number: int) -> int:
    """What a machine without memory does to a process."""
    if number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


@pytest.fixture
def no_joblib(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "joblib", None)


@pytest.mark.parametrize("backend", ["threading", "sequential"])
def test_results_come_in_the_order_of_the_items(backend: str) -> None:
    with joblib.parallel_config(backend):
        done = list(in_order(SlowerFirst(), range(20), jobs=4))
    assert done == [-number for number in range(20)]


@pytest.mark.usefixtures("no_joblib")
@pytest.mark.parametrize(("count", "jobs"), [(0, None), (1, 8), (30, 1), (WORTH_A_PROCESS, None)])
def test_one_item_one_job_or_few_items_need_no_process(count: int, jobs: int | None) -> None:
    assert list(in_order(abs, range(count), jobs)) == list(range(count))


def test_a_result_is_there_before_the_next_item_is_begun() -> None:
    begun: list[int] = []
    done = in_order(begun.append, range(3), jobs=1)
    next(iter(done))
    assert begun == [0]


def test_leaving_early_says_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    with joblib.parallel_config("threading"):
        done = in_order(SlowerFirst(), range(20), jobs=2)
        assert isinstance(done, Iterator)
        assert next(done) == 0
        del done
    assert capfd.readouterr().err == ""


@pytest.mark.machine
@pytest.mark.slow
def test_a_process_that_dies_is_told_on_one_line() -> None:
    with pytest.raises(MadrobError, match="a worker process died: make memory free"):
        list(in_order(die, range(8), jobs=2))
    assert list(in_order(abs, range(-8, 0), jobs=2)) == [*range(8, 0, -1)]


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The results folder of the settings; nothing is in it."""
    results = tmp_path / "results"
    results.mkdir()
    settings = tmp_path / "config" / "madrob" / "madrob.toml"
    settings.parent.mkdir(parents=True)
    settings.write_text(f'[results]\nfolder = "{results}"\n')
    monkeypatch.chdir(tmp_path)
    return results


def put(results: Path, *places: str) -> str:
    """Put a run there; returns its name."""
    for place in places:
        film(Path(shutil.copytree(completed(), results / place / completed().name)), "/camera/a")
    return completed().name


COMMANDS = (
    ("report", "{}"),
    ("pictures", "{}"),
    ("score", "{}"),
    ("recover", "{}"),
    ("export", "--dossier", "--run", "{}"),
    ("table", "samples", "--output", "tables", "{}"),
    ("table", "runs", "{}"),
    ("run", "--speed", "0", "--testbed", "replay", "{}"),
)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_finds_a_run_by_its_name(
    results: Path, command: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    name = put(results, "practice")
    assert main([word.format(name) for word in command]) == 0, capsys.readouterr().err


def test_official_runs_are_found_too_and_practice_by_its_whole_name(results: Path) -> None:
    name = put(results, ".")
    assert main(["score", name]) == 0
    (results / "practice").mkdir()
    (results / name).rename(results / "practice" / name)
    assert main(["score", f"practice/{name}"]) == 0


@pytest.mark.parametrize("command", [("score", "{}"), ("export", "--dossier", "--run", "{}")])
def test_a_name_that_two_runs_have_is_refused_with_both(
    results: Path, command: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    name = put(results, ".", "practice")
    assert main([word.format(name) for word in command]) == 2
    told = capsys.readouterr()
    both = f"give {results / name} or {results / 'practice' / name}"
    assert told.err == f"madrob: {name}: two runs are called so: {both}\n"
    assert main([word.format(f"practice/{name}") for word in command]) == 0


def test_what_is_there_is_meant_and_not_what_the_results_folder_calls_so(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = put(results, "practice")
    put(tmp_path, ".")
    assert main(["report", name]) == 0
    assert Path(capsys.readouterr().out.strip()) == tmp_path / name / "report.html"


def test_the_results_folder_that_is_named_is_looked_in(
    results: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = put(tmp_path / "other", "practice")
    assert main(["export", "--run", name, "--dossier"]) == 2
    assert f"{results / name}: no such run folder" in capsys.readouterr().err
    there = ("--results", str(tmp_path / "other"))
    assert main(["export", "--run", name, "--dossier", *there]) == 0
    assert (tmp_path / "other" / "exports" / f"dossier_practice_{name}.zip").is_file()
