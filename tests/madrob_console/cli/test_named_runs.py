"""A run is found by its name in the results folder, whatever command takes it."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from madrob_console.cli.main import main
from tests.madrob_console.cameras.frames import film
from tests.madrob_console.recorded_runs import completed


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The results folder of the settings; nothing is in it."""
    results = tmp_path / "results"
    results.mkdir()
    settings = tmp_path / "config" / "madrob" / "madrob.toml"
    settings.parent.mkdir(parents=True)
    settings.write_text(f'[results]\nfolder = "{results}"\n')
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
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
