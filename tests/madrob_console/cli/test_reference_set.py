"""`madrob doctor --reference`: whether this installation scores right."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import msgspec
import pytest

from madrob_console.archive import run_record
from madrob_console.archive.run_record import RunRecord
from madrob_console.cli import reference_set
from madrob_console.cli.output import BAD_INPUT
from madrob_console.cli.reference_set import (
    ARCHIVE,
    EXPECTED_FILE,
    FOLDER,
    recordings_of,
)
from recorder.reader import Bag
from scoring.assessment import Assessment
from scoring.protocol import Thresholds
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.references.bags import messages, record_of
from tests.madrob_console.references.runs import RUNS, ReferenceRun
from tests.madrob_console.references.truth import expected_text, reference

ROOT = Path(__file__).parents[3]
NAMES = [run.name for run in RUNS]


DOCTOR = "doctor --reference"


@pytest.fixture
def copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the shipped files, which the doctor takes for them."""
    folder = tmp_path / "references"
    shutil.copytree(FOLDER, folder)
    monkeypatch.setattr(reference_set, "FOLDER", folder)
    return folder


def test_this_installation_scores_right_and_needs_no_ros(
    monkeypatch: pytest.MonkeyPatch, madrob: Madrob
) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    said = madrob.say(DOCTOR)
    assert (said.code, said.err) == (0, "")
    first, *lines, last = said.out.splitlines()
    number = r"\d+(\.\d+)+\S*"
    libraries = rf"NumPy {number}, SciPy {number}, pandas {number}"
    assert re.fullmatch(rf"ok       versions +Python {number}, {libraries}", first)
    assert [line.split()[:2] for line in lines] == [["ok", name] for name in NAMES]
    values = 12 * (1 + 6 + 2 * 8)
    assert last == f"this installation scores right (12 references, {values} values)"


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"touch_force": 5.0}, "force_pulses time_to_handle by protocol"),
    ({"closed_angle": 0.045}, "minimum_jerk passage_time by eurobench-2020"),
    ({"lintel_height": 2.6}, "minimum_jerk capability_level by protocol: 3, expected 6"),
    ({"settle_time": 3.0}, "push_to_cw step 6"),
    ({"mask_from": (0.06,) * 5}, "push_to_cw step 4"),
    ({"mask_to_cw": (0.2,) * 5}, "push_to_cw door_occupation_time by eurobench-2020"),
]


@pytest.mark.parametrize(("wrong", "off"), WRONG, ids=str)
def test_a_wrong_threshold_is_named_with_its_value(
    wrong: dict[str, Any], off: str, copy: Path, monkeypatch: pytest.MonkeyPatch, madrob: Madrob
) -> None:
    right: Callable[..., Assessment] = RunRecord.assessment

    def spoilt(record: RunRecord, *rest: object) -> Assessment:
        return right(replace(record, thresholds=replace(Thresholds(), **wrong)), *rest)

    monkeypatch.setattr(RunRecord, "assessment", spoilt)
    # the one recording that `off` begins with is looked at
    path, recording = copy / EXPECTED_FILE, f"{off.split(maxsplit=1)[0]}.mcap"
    kept = [one for one in msgspec.json.decode(path.read_bytes()) if one["recording"] == recording]
    path.write_bytes(msgspec.json.encode(kept))
    lines = madrob(DOCTOR, code=1).splitlines()
    errors = [" ".join(line.split()[1:]) for line in lines if line.startswith("error ")]
    assert any(line.startswith(off) for line in errors), errors
    assert all(re.search(r": .+, expected \S+", line) for line in errors)
    assert re.match(rf"{len(errors)} values? (is|are) off: do not use this instal", lines[-1])


@pytest.mark.usefixtures("copy")
def test_a_recording_that_cannot_be_scored_has_all_its_values_off(
    madrob: Madrob, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Assessment, "result", Mock(side_effect=ZeroDivisionError))
    lines = madrob(DOCTOR, code=1).splitlines()
    assert len(lines) == 1 + len(RUNS) + 1
    assert lines[-1].startswith("276 values are off: ")


def flipped(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 255
    path.write_bytes(content)


def in_its_place(path: Path) -> None:
    path.unlink()
    path.mkdir()


NOT_AS_SHIPPED: dict[str, Callable[[Path], object]] = {
    "missing": Path.unlink,
    "torn": lambda path: os.truncate(path, path.stat().st_size // 2),
    "changed": flipped,
    "a folder": in_its_place,
    "empty": lambda path: os.truncate(path, 0),
}


@pytest.mark.parametrize("name", [EXPECTED_FILE, ARCHIVE])
@pytest.mark.parametrize("how", NOT_AS_SHIPPED)
def test_a_file_that_is_not_as_it_was_shipped_is_one_clear_line(
    name: str, how: str, copy: Path, madrob: Madrob
) -> None:
    NOT_AS_SHIPPED[how](copy / name)
    said = madrob.say(DOCTOR)
    assert (said.code, said.out.count("\n")) == (BAD_INPUT, 1)  # the versions
    line = rf"madrob: {re.escape(str(copy / name))}: .*: install madrob-console again\n"
    assert re.fullmatch(line, said.err)


@pytest.fixture(scope="module")
def recordings() -> Iterator[Path]:
    with recordings_of(FOLDER) as unpacked:
        yield unpacked


@pytest.mark.parametrize("run", RUNS, ids=NAMES)
def test_the_shipped_recordings_are_made_again_bit_for_bit(
    run: ReferenceRun, recordings: Path
) -> None:
    bag = Bag(recordings / f"{run.name}.mcap")
    assert list(bag.messages()) == list(messages(run))
    assert bag.complete
    assert RunRecord.from_metadata(bag.records[run_record.RECORD_NAME]) == record_of(run)


def test_the_shipped_answers_are_those_of_the_formulas() -> None:
    made = [reference(run) for run in RUNS]
    told = msgspec.json.decode((FOLDER / EXPECTED_FILE).read_bytes())
    assert_close(told, msgspec.json.decode(expected_text(made)))


def assert_close(told: object, made: object) -> None:
    """Numbers agree as far as other processors and libraries leave them, all else to the letter."""
    match told, made:
        case dict(), dict():
            assert told.keys() == made.keys()
            for key in told:
                assert_close(told[key], made[key])
        case list(), list():
            assert len(told) == len(made)
            for one, other in zip(told, made, strict=True):
                assert_close(one, other)
        case float(), float():
            assert told == pytest.approx(made, rel=1e-9, abs=1e-9)
        case _:
            assert told == made


@pytest.mark.slow
@pytest.mark.machine
def test_a_wheel_carries_guide_and_references_and_what_it_unpacks_to_scores_right(
    tmp_path: Path,
) -> None:
    dist = tmp_path / "dist"
    pip = [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", str(dist), str(ROOT)]
    subprocess.check_call(pip)
    (wheel,) = dist.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "unpacked")
    command = "from madrob_console.cli.reference_set import FOLDER; print(FOLDER);"
    command += "from madrob_console.cli.main import main; main(['guide', 'robots']);"
    command += "print(main(['doctor', '--reference']))"
    told = subprocess.check_output(
        [sys.executable, "-P", "-c", command],
        env={**os.environ, "PYTHONPATH": str(tmp_path / "unpacked")},
        text=True,
        cwd=tmp_path,
    ).splitlines()
    assert Path(told[0]).is_relative_to(tmp_path / "unpacked")
    page = (ROOT / "madrob_console" / "guide" / "robots.md").read_text().splitlines()
    assert told[1 : len(page) + 1] == page
    assert told[-1] == "0"
