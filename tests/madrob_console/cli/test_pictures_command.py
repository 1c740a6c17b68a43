"""`madrob pictures`: frames of a run's cameras as files."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest
from PIL import Image

from madrob_console.archive.run_journal import journal_held
from madrob_console.cli.main import main
from madrob_console.export.zip_file import safe_names
from madrob_console.referee.evidence_account import EvidenceAccount, RecordedTopic
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change
from tests.madrob_console.archive.frames import film, raw, span, stream
from tests.madrob_console.recorded_runs import completed
from tests.recorder.samples import add_evidence, strings

FRONT, SIDE = "/camera/front", "/camera/side"


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    return Path(shutil.copytree(completed(), tmp_path / completed().name))


@pytest.fixture
def run(bare: Path) -> Path:
    film(bare, FRONT, SIDE)
    return bare


def test_each_camera_s_frame_at_an_instant_becomes_a_file_that_is_printed(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "frames"
    assert main(["pictures", str(run), "--at", "5.25", "--output", str(output)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2
    for line in lines:
        path, _, told = line.partition(": ")
        assert Path(path).parent == output
        assert Path(path).name.startswith(f"{run.name}_01_at_5_250_s_camera_")
        ms, side = int(told.split()[0]), ""
        if ms:
            side = "_later" if ms > 0 else "_earlier"
        assert path.endswith(f"_{abs(ms)}_ms{side}.jpg")
        assert re.fullmatch(r"[-+]?\d+ ms", told)
        with Image.open(path) as picture:
            picture.load()
    assert len(list(output.iterdir())) == 2
    assert not (run / "pictures").exists()


def test_without_pillow_pictures_are_refused_in_one_line_and_those_made_before_stay(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(["pictures", str(run)]) == 0
    made = {path.name: path.read_bytes() for path in (run / "pictures").iterdir()}
    capsys.readouterr()
    monkeypatch.setitem(sys.modules, "PIL", None)
    assert main(["pictures", str(run), "--at", "5.25", "--output", str(run / "frames")]) == 2
    said = capsys.readouterr()
    assert (said.out, said.err.count("\n")) == ("", 1)
    assert "Pillow: install madrob-console with its extra `report`" in said.err
    assert main(["report", str(run)]) == 0
    assert "need Pillow: install madrob" in (run / "report.html").read_text()
    assert {path.name: path.read_bytes() for path in (run / "pictures").iterdir()} == made


def test_a_file_of_an_instant_before_the_start_says_so_in_its_name(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "frames"
    assert main(["pictures", str(run), "--at", "-0.25", "--output", str(output)]) == 0
    found = [item.name for item in output.iterdir()]
    assert found
    assert all(name.startswith(f"{run.name}_01_at_minus_0_250_s_camera_") for name in found)
    capsys.readouterr()


def test_in_the_folder_of_the_run_names_are_such_that_a_zip_keeps_them_whole(
    bare: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    long = "/hall_north/testbed/camera_beside_the_door/color/image_raw/compressed"
    film(bare, f"{long}/left", f"{long}/right")
    output = bare / "frames"
    wanted = ["--at", "5.25", "--at", "benchmark_start"]
    assert main(["pictures", str(bare), *wanted, "--output", str(output)]) == 0
    names = [item.name for item in output.iterdir()]
    assert len(names) == 4
    assert safe_names(names) == {name: name for name in names}
    assert all(re.search(r"_\d+_ms(_later|_earlier)?[.]jpg$", name) for name in names)
    assert all(name.startswith(("01_at_5_250_s_", "02_benchmark_start_")) for name in names)
    made = capsys.readouterr().out
    assert all(f"{output / name}: " in made for name in names)


def test_an_instant_may_be_an_event_and_cameras_may_be_chosen(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    at = ["--at", "door_opens", "--at", "0:03"]
    assert main(["pictures", str(run), *at, "--camera", "*fro*"]) == 0
    names = [line.partition(": ")[0] for line in capsys.readouterr().out.splitlines()]
    assert [re.sub(r"_\d+_ms(_later|_earlier)?[.]jpg$", "", name) for name in names] == [
        f"{run.name}_01_door_opens_camera_front",
        f"{run.name}_02_at_3_000_s_camera_front",
    ]
    assert all((tmp_path / name).is_file() for name in names)


def test_without_an_instant_the_run_s_own_pictures_are_made_anew(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["pictures", str(run)]) == 0
    lines = capsys.readouterr().out.splitlines()
    files = {line.partition(": ")[0] for line in lines}
    assert files == {str(path) for path in (run / "pictures").glob("*.jpg")}


def test_pictures_can_be_as_large_as_they_were_sent(bare: Path, tmp_path: Path) -> None:
    begin, end = span(bare)
    add_evidence(bare, stream(FRONT, begin, end, rate=2, size=(1920, 1080)))
    for width, size in ((None, (960, 540)), (1920, (1920, 1080)), (64, (64, 36))):
        output = tmp_path / f"{width}"
        given = [] if width is None else ["--width", str(width)]
        assert main(["pictures", str(bare), "--at", "1", "--output", str(output), *given]) == 0
        with Image.open(next(output.iterdir())) as picture:
            assert picture.size == size


def test_a_run_whose_evidence_was_removed_or_lost_says_which(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    account = EvidenceAccount((RecordedTopic(FRONT, "a/msg/B", 300, 6_000_000),))
    at, system = 1_700_000_000.0, Origin.SYSTEM
    recorded = msgspec.to_builtins(account)
    for file in run.glob("*_evidence_*"):
        file.unlink()
    with journal_held(run) as journal:
        journal.append([Entry(at, system, Change.EVIDENCE_RECORDED.value, details=recorded)])
    assert main(["pictures", str(run)]) == 2
    gone = f"{run}: its evidence is gone (1 topic, 300 messages, 6.0 MB were recorded): look"
    assert gone in capsys.readouterr().err
    with journal_held(run) as journal:
        removed = {"files": ["one"], "bytes": 6_000_000}
        journal.append([Entry(at, system, Change.EVIDENCE_REMOVED.value, details=removed)])
    assert main(["pictures", str(run)]) == 2
    assert f"{run}: its evidence was removed by `madrob tidy` (1 file, 6" in capsys.readouterr().err


def test_a_run_without_evidence_is_named_with_what_to_do(
    bare: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["pictures", str(bare)]) == 2
    assert f"{bare}: was recorded without evidence: choose" in capsys.readouterr().err
    assert main(["pictures", str(tmp_path)]) == 2
    assert f"{tmp_path}: no run is there: name the folder of a run" in capsys.readouterr().err
    for path in (bare / "result.json", tmp_path / "nowhere"):
        assert main(["pictures", str(path)]) == 2
        assert f"{path}: no such run folder: name the folder" in capsys.readouterr().err
    add_evidence(bare, strings(["no camera"]))
    assert main(["pictures", str(bare)]) == 2
    assert "no camera * in its evidence" in capsys.readouterr().err


def test_a_depth_camera_is_shown_with_its_distances_as_caption(
    bare: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    begin, end = span(bare)
    depths = np.linspace(0.4, 6.1, 64 * 48, dtype="<f4").tobytes()
    times = np.arange(begin, end, 0.2)
    frames = [
        raw(depths, "32FC1", 64, 48, 256, topic="/camera/depth", stamp=at, log=at + 0.01)
        for at in times
    ]
    add_evidence(bare, frames)
    assert main(["pictures", str(bare), "--at", "5", "--output", str(tmp_path / "frames")]) == 0
    path, _, told = capsys.readouterr().out.partition(": ")
    assert re.search(r"^[-+]?\d+ ms; depth 0[.]4 to 6[.]1 m$", told.strip())
    with Image.open(path) as picture:
        assert (picture.mode, picture.size) == ("L", (64, 48))
    assert main(["report", str(bare)]) == 0
    page = (bare / "report.html").read_text()
    assert page.count("<small>depth 0.4 to 6.1 m</small>") == page.count("<img ") > 0
