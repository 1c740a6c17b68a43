"""`--testbed replay` on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from madrob_console.cli.main import main
from madrob_console.referee.acts import Abort
from tests.madrob_console.engine.drive import Drive, make_setup


@pytest.fixture(autouse=True)
def _own_settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was aborted after two seconds."""
    drive = Drive(tmp_path_factory.mktemp("results"))
    drive.start(make_setup(countdown=1.0))
    drive.wait(2.0)
    drive.act(Abort("robot on fire"))
    drive.finish()
    drive.engine.close()
    assert drive.engine.folder is not None
    return drive.engine.folder


def replay(path: Path, *flags: str) -> int:
    return main(["run", "--testbed", "replay", str(path), "--speed", "0", *flags])


def test_a_replay_without_screens_prints_the_run_and_records_nothing(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(folder.parent.rglob("*"))
    assert replay(folder, "--results", str(tmp_path / "results")) == 4
    output = capsys.readouterr().out.splitlines()
    assert output[0] == f"testbed: REPLAY {folder.name}"
    assert any("referee   abort: robot on fire" in line for line in output)
    assert output[-2:] == [
        "replay: equals the stored result to the last digit; nothing was recorded",
        f"run folder: {folder}",
    ]
    assert sorted(folder.parent.rglob("*")) == before
    assert not (tmp_path / "results").exists()


def test_a_replay_of_a_torn_bag_says_where_it_ends(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (bag,) = folder.glob("*.mcap")
    data = bag.read_bytes()
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(data[: len(data) * 2 // 3])
    assert replay(torn) in (4, 5)
    assert "note: " + str(torn) in capsys.readouterr().out


def test_what_cannot_be_replayed_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run.mcap").write_text(json.dumps({}))
    for path in (tmp_path / "run.mcap", tmp_path / "nothing"):
        assert replay(path) == 2
        error = capsys.readouterr().err
        assert path.name in error
        assert error.count("\n") == 1


@pytest.mark.parametrize(
    "flags",
    [
        ["--from", "3"],
        ["--from", "3", "--testbed", "simulated"],
        ["--from", "nan", "--testbed", "replay", "x"],
        ["--from", "soon", "--testbed", "replay", "x"],
    ],
)
def test_only_a_replay_begins_at_a_time_and_it_must_be_one(
    flags: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code = main(["console", *flags])
    except SystemExit as ended:
        code = int(str(ended.code))
    error = capsys.readouterr().err
    assert code == 2
    assert "--from" in error
    assert error.count("\n") == 1
