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
from madrob_console.export.zip_file import is_safe_name
from madrob_console.referee.evidence_account import EvidenceAccount, RecordedTopic
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change
from tests.madrob_console.archive.frames import film, raw, span, stream
from tests.madrob_console.cli.typed import Madrob
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


def pictures(madrob: Madrob, line: str, run: Path, output: Path | None = None) -> list[list[str]]:
    """Path of each picture that is made and what is told of it."""
    where = [] if output is None else ["--output", output]
    return [row.split(": ") for row in madrob(f"pictures {line}", run, *where).splitlines()]


def test_each_camera_s_frame_at_an_instant_becomes_a_file_that_is_printed(
    run: Path, tmp_path: Path, madrob: Madrob
) -> None:
    output = tmp_path / "frames"
    made = pictures(madrob, "--at 5.25", run, output)
    assert [path for path, _ in made] == sorted(map(str, output.iterdir()))
    assert len(made) == 2
    for path, told in made:
        assert re.fullmatch(r"[-+]?\d+ ms", told)
        ms = int(told.removesuffix(" ms"))
        side = "" if ms == 0 else "_later" if ms > 0 else "_earlier"
        assert Path(path).name.startswith(f"{run.name}_01_at_5_250_s_camera_")
        assert path.endswith(f"_{abs(ms)}_ms{side}.jpg")
        with Image.open(path) as picture:
            picture.load()
    assert not (run / "pictures").exists()


def test_without_pillow_pictures_are_refused_in_one_line_and_those_made_before_stay(
    run: Path, madrob: Madrob, monkeypatch: pytest.MonkeyPatch
) -> None:
    madrob("report", run)  # what draws is imported whole
    own = pictures(madrob, "", run)
    made = {str(path): path.read_bytes() for path in (run / "pictures").glob("*.jpg")}
    assert {path for path, _ in own} == made.keys()
    monkeypatch.setitem(sys.modules, "PIL", None)
    said = madrob.refusal("pictures --at 5.25", run, "--output", run / "frames")
    assert "Pillow: install madrob-console with its extra `report`" in said
    madrob("report", run)
    assert "need Pillow: install madrob" in (run / "report.html").read_text()
    assert {str(path): path.read_bytes() for path in (run / "pictures").glob("*.jpg")} == made


def test_in_the_folder_of_the_run_names_are_such_that_a_zip_keeps_them_whole(
    bare: Path, madrob: Madrob
) -> None:
    long = "/hall_north/testbed/camera_beside_the_door/color/image_raw/compressed"
    film(bare, f"{long}/left", f"{long}/right")
    made = pictures(madrob, "--at 5.25 --at benchmark_start", bare, bare / "frames")
    names = [item.name for item in (bare / "frames").iterdir()]
    assert {Path(path).name for path, _ in made} == {*names}
    assert len(names) == 4
    assert all(map(is_safe_name, names))
    name = r"0(1_at_5_250_s|2_benchmark_start)_.*_\d+_ms(_later|_earlier)?[.]jpg"
    assert all(re.fullmatch(name, one) for one in names)


@pytest.mark.parametrize(
    ("at", "named"),
    [
        ("--at door_opens --at 0:03", ["01_door_opens", "02_at_3_000_s"]),
        ("--at -0.25", ["01_at_minus_0_250_s"]),
    ],
)
def test_an_instant_may_be_an_event_or_before_the_start_and_cameras_may_be_chosen(
    at: str, named: list[str], run: Path, tmp_path: Path, madrob: Madrob,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    names = [path for path, _ in pictures(madrob, f"{at} --camera *fro*", run)]
    assert [re.sub(r"_\d+_ms(_later|_earlier)?[.]jpg$", "", name) for name in names] == [
        f"{run.name}_{one}_camera_front" for one in named
    ]
    assert all((tmp_path / name).is_file() for name in names)


@pytest.mark.parametrize(
    ("width", "size"),
    [("", (960, 540)), ("--width 1920", (1920, 1080)), ("--width 64", (64, 36))],
)
def test_pictures_can_be_as_large_as_they_were_sent(
    width: str, size: tuple[int, int], bare: Path, tmp_path: Path, madrob: Madrob
) -> None:
    add_evidence(bare, stream(FRONT, *span(bare), rate=2, size=(1920, 1080)))
    ((path, _),) = pictures(madrob, f"--at 1 {width}", bare, tmp_path / "frames")
    with Image.open(path) as picture:
        assert picture.size == size


def test_a_run_whose_evidence_was_removed_or_lost_says_which(run: Path, madrob: Madrob) -> None:
    account = EvidenceAccount((RecordedTopic(FRONT, "a/msg/B", 300, 6_000_000),))
    for file in run.glob("*_evidence_*"):
        file.unlink()
    for change, details, words in (
        (
            Change.EVIDENCE_RECORDED,
            msgspec.to_builtins(account),
            "its evidence is gone (1 topic, 300 messages, 6.0 MB were recorded): look",
        ),
        (
            Change.EVIDENCE_REMOVED,
            {"files": ["one"], "bytes": 6_000_000},
            "its evidence was removed by `madrob tidy` (1 file, 6",
        ),
    ):
        with journal_held(run) as journal:
            journal.append([Entry(1_700_000_000.0, Origin.SYSTEM, change.value, details=details)])
        assert f"{run}: {words}" in madrob.refusal("pictures", run)


def test_evidence_without_a_camera_has_no_pictures(bare: Path, madrob: Madrob) -> None:
    add_evidence(bare, strings(["no camera"]))
    assert "no camera * in its evidence" in madrob.refusal("pictures", bare)


def test_a_depth_camera_is_shown_with_its_distances_as_caption(
    bare: Path, tmp_path: Path, madrob: Madrob
) -> None:
    depths = np.linspace(0.4, 6.1, 64 * 48, dtype="<f4").tobytes()
    frames = [
        raw(depths, "32FC1", 64, 48, 256, topic="/camera/depth", stamp=at, log=at + 0.01)
        for at in np.arange(*span(bare), 0.2)
    ]
    add_evidence(bare, frames)
    ((path, told),) = pictures(madrob, "--at 5", bare, tmp_path / "frames")
    assert re.fullmatch(r"[-+]?\d+ ms; depth 0[.]4 to 6[.]1 m", told)
    with Image.open(path) as picture:
        assert (picture.mode, picture.size) == ("L", (64, 48))
    madrob("report", bare)
    page = (bare / "report.html").read_text()
    assert page.count("<small>depth 0.4 to 6.1 m</small>") == page.count("<img ") > 0
