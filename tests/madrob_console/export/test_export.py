"""`madrob export`: the zip that a team takes home."""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import time
import unicodedata
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import jsonschema
import msgspec
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag2 import Reader

from madrob_console.archive.collection import collected_in
from madrob_console.archive.folders import run_folder_names
from madrob_console.cli.main import main
from madrob_console.cli.output import BAD_INPUT
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import Hold, open_plain
from madrob_console.export import pack, zip_file
from madrob_console.export.dossier import protest_lines
from madrob_console.export.foxglove_layout import HandleZero, foxglove_layout
from madrob_console.export.pack import BagParts
from madrob_console.export.team import export_team, file_name
from madrob_console.export.zip_file import LONGEST_PATH, safe_names
from madrob_console.messages.codec import (
    DEFAULT_MAPPINGS,
    REFEREE_EVENT_TOPIC,
    REFEREE_START_POSE_TOPIC,
    REFEREE_STATE_TOPIC,
    START_POSE_FRAME,
    TopicMapping,
    referee_topics,
)
from madrob_console.messages.message_types import MessageTypes
from madrob_console.pages.templates import path_link
from madrob_console.referee.evidence_account import (
    EvidenceAccount,
    EvidenceGap,
    EvidenceLoss,
    RecordedTopic,
)
from madrob_console.referee.journal import HOLD_FILE
from madrob_console.referee.records import Protest, RemovedEvidence
from madrob_console.referee.run import Run
from madrob_console.testbeds.simulated import Scenario
from recorder.bag import evidence_file_name
from recorder.reader import read_bag
from recorder.survey import put_listing
from recorder.writer import BagWriter
from scoring.protocol import Outcome, Signal, Thresholds
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.pages.competition_runs import put_recorded
from tests.madrob_console.run_folders import EPOCH, UNDECIDED_START, summary, write
from tests.recorder.samples import add_evidence, strings, talk

NOW = 1_790_000_000.0


@pytest.fixture(autouse=True)
def _own_settings(
    monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path_factory.getbasetemp() / "config"))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results folder with a recorded run of team 3."""
    root = tmp_path_factory.mktemp("recorded")
    drive = Drive(root, Scenario.NO_TOUCH)
    drive.whole_run(make_setup(timeout=2.0))
    drive.engine.close()
    return root


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Three runs of team 3 and one of team 4; a few small files in each."""
    root = tmp_path / "results"
    for hour, (subject, number) in enumerate([(3, 1), (4, 1), (3, 2), (3, 3)]):
        run = summary(subject, run_number=number, hour=hour, team=f"Team {subject}")
        folder = write(root, run).parent
        (folder / f"{folder.name}_0.mcap").write_bytes(os.urandom(300))
        (folder / "metadata.yaml").write_text("bag\n")
        (folder / f"{folder.name[:28]}_jointState.csv").write_text("time,position\n1,2\n")
    return root


def folders(root: Path, subject: int = 3) -> list[Path]:
    names = run_folder_names(root)
    return sorted(root / name for name in names if f"subject_{subject:03d}" in name)


def export(root: Path, *, bags: bool = True, practice: bool = False) -> pack.Export:
    def report(_run: Path) -> tuple[dict[str, bytes], list[str]]:
        return {"report.html": b"page"}, []

    return export_team(
        collected_in(root),
        3,
        DEFAULT_MAPPINGS,
        NOW,
        parts=BagParts(bags),
        practice=practice,
        report=report,
    )


def unpacked(path: Path, target: Path) -> Path:
    """A clean folder with what is in a zip."""
    with zipfile.ZipFile(path) as packed:
        assert packed.testzip() is None
        packed.extractall(target)
    return target


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """An engine works on the run."""
    with Hold(folder / HOLD_FILE):
        yield


@pytest.mark.machine
def test_a_team_opens_every_file_of_its_zip_as_the_text_in_it_says(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "home.zip"
    assert (
        main(
            [
                *["export", "--practice", "--subject=3"],
                f"--results={recorded}",
                f"--output={target}",
            ]
        )
        == 0
    )
    said = capsys.readouterr()
    assert said.out.splitlines()[-1] == str(target)
    assert said.err == ""
    home = unpacked(target, tmp_path / "home")
    sums = subprocess.run(
        ["sha256sum", "-c", "SHA256SUMS"], cwd=home, capture_output=True, text=True, check=True
    )
    assert sums.stdout.count(": OK") == sum(path.is_file() for path in home.rglob("*")) - 1
    (run,) = folders(recorded)
    for path in run.iterdir():
        assert (home / run.name / path.name).read_bytes() == path.read_bytes()
    text = (home / "README.txt").read_text()
    begin = text.index("import pandas")
    namespace: dict[str, object] = {}
    lines = text[begin : text.index("\n\n", begin)]
    assert lines.count("\n") == 2
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(home)
        exec(lines, namespace)
    assert "acceleration" in capsys.readouterr().out
    assert f"ros2 bag play {run.name}\n" in text
    assert len(list(read_bag(home / run.name).messages())) > 1000
    schema = json.loads((home / "madrob_result_schema_1.json").read_text())
    jsonschema.validate(json.loads((home / run.name / "result.json").read_text()), schema)
    assert json.loads((home / "madrob_foxglove_layout.json").read_text())["layout"]


def test_a_zip_has_the_name_of_the_list_and_tells_the_others(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    teams = tmp_path / "teams.csv"
    teams.write_text("3,Delft Walkers\n")
    write(root, summary(3, run_number=4, hour=9, team="TEST"))
    target = tmp_path / "3.zip"
    called = [f"--results={root}", f"--output={target}", f"--teams={teams}"]
    assert main(["export", "--subject=3", *called]) == 0
    text = (unpacked(target, tmp_path / "home") / "README.txt").read_text()
    assert text.startswith("MADROB: runs of subject 3 Delft Walkers\n")
    first, second, _, last = sorted(path.name for path in root.glob("subject_003*"))
    names = f"  Team 3: {first}, {second} and 1 more\n  TEST: {last}\n"
    assert f"OTHER NAMES OF THE TEAM, IN SOME OF ITS RUNS\n{names}" in text
    said = capsys.readouterr().out.splitlines()
    assert f"note: another name of the team, TEST: {last}" in said
    assert f"note: another name of the team, Team 3: {first}, {second} and 1 more" in said


def test_without_a_list_the_name_of_a_practice_run_is_not_that_of_the_zip(root: Path) -> None:
    write(root, summary(3, run_number=4, hour=9, team="TEST", source="simulated"))
    assert export(root).path == root / "exports" / file_name(3, "Team 3", NOW)


def test_only_the_teams_runs_are_packed_oldest_first(root: Path) -> None:
    made = export(root)
    assert made.path == root / "exports" / file_name(3, "Team 3", NOW)
    with zipfile.ZipFile(made.path) as packed:
        names = packed.namelist()
    packed_runs = list(dict.fromkeys(name.split("/")[0] for name in names if "/" in name))
    assert packed_runs == [folder.name for folder in folders(root)]
    assert names[-4:] == [
        "madrob_result_schema_1.json",
        "madrob_foxglove_layout.json",
        "README.txt",
        "SHA256SUMS",
    ]
    assert (made.runs, made.files, made.problems) == (3, len(names), ())
    assert made.size == made.path.stat().st_size


def test_the_same_runs_give_the_same_bytes(root: Path) -> None:
    first = export(root).path.read_bytes()
    assert export(root).path.read_bytes() == first


def test_the_zips_are_no_runs(root: Path) -> None:
    before = sorted(run_folder_names(root))
    export(root)
    assert sorted(run_folder_names(root)) == before


def test_recordings_can_be_left_out(root: Path) -> None:
    (folders(root)[0] / "x_0.mcap.torn").write_bytes(b"torn")
    with zipfile.ZipFile(export(root, bags=False).path) as packed:
        assert not any("mcap" in name or "metadata" in name for name in packed.namelist())
        text = packed.read("README.txt").decode()
    assert "ros2 bag play" not in text
    assert "  the recording was left out on demand\n" in text


def test_what_the_cameras_saw_goes_along(root: Path, tmp_path: Path) -> None:
    run = folders(root)[0]
    (run / "report.html").write_text("page")
    assert "cameras" not in text_in(export(root))
    (run / "pictures").mkdir()
    for name in ("index.json", "01_door_opens_camera.jpg"):
        (run / "pictures" / name).write_bytes(name.encode())
    made = export(root, bags=False)
    there = unpacked(made.path, tmp_path / "there") / run.name / "pictures"
    assert {path.name: path.read_bytes() for path in there.iterdir()} == {
        path.name: path.read_bytes() for path in (run / "pictures").iterdir()
    }
    assert "what the cameras saw at each event" in text_in(made)


FRAMES = strings(["a picture", "another"])


def bag_of(folder: Path, *numbers: int) -> int:
    """A real bag with evidence in place of that of a run; how many messages its recording has."""
    for name in (f"{folder.name}_0.mcap", "metadata.yaml"):
        (folder / name).unlink()
    aside = folder.parent / "aside" / folder.name
    aside.parent.mkdir()
    with BagWriter(aside, [talk()], {}) as writer:
        for message in FRAMES:
            writer.put_message(message)
    for path in aside.iterdir():
        path.rename(folder / path.name)
    for number in numbers:
        add_evidence(folder, FRAMES, number)
    fd = os.open(folder, os.O_DIRECTORY)
    assert put_listing(fd) is not None
    os.close(fd)
    return len(FRAMES)


def opened_by_others(folder: Path) -> tuple[list[str], int]:
    """The files that metadata.yaml lists, and how many messages rosbags finds in them."""
    listed = yaml.safe_load((folder / "metadata.yaml").read_text())
    with Reader(folder) as reader:
        count = sum(1 for _ in reader.messages())
    return listed["rosbag2_bagfile_information"]["relative_file_paths"], count


def test_evidence_is_packed_and_the_readme_tells_of_it(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = folders(root)[0]
    bag_of(run, 0, 1)
    assert main(["export", "--subject=3", f"--results={root}"]) == 0
    said = capsys.readouterr()
    assert re.fullmatch(
        r"madrob: note: packing 0\.\d MB, 0\.\d MB of it evidence "
        r"\(--without-evidence leaves that out\)\n",
        said.err,
    )
    there = unpacked(Path(said.out.splitlines()[-1]), tmp_path / "there")
    names = [f"{run.name}_0.mcap", f"{run.name}_evidence_0.mcap", f"{run.name}_evidence_1.mcap"]
    assert opened_by_others(there / run.name) == (names, 6)
    text = (there / "README.txt").read_text()
    assert f"  {run.name}_evidence_0.mcap: evidence: cameras and" in text


def test_evidence_can_be_left_out_and_metadata_lists_what_is_there(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = folders(root)[0]
    count = bag_of(run, 0)
    assert main(["export", "--subject=3", "--without-evidence", f"--results={root}"]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    there = unpacked(Path(said.out.splitlines()[-1]), tmp_path / "there")
    assert opened_by_others(there / run.name) == ([f"{run.name}_0.mcap"], count)
    assert not list(there.rglob("*evidence*"))
    text = (there / "README.txt").read_text()
    assert "NOT IN THIS ARCHIVE\n  the evidence was left out on demand\n" in text
    assert "evidence: cameras" not in text
    plain = export(root, bags=False)
    with zipfile.ZipFile(plain.path) as packed:
        assert not any("evidence" in name for name in packed.namelist())
        text = packed.read("README.txt").decode()
        assert "the recording was left out on demand\n  the evidence was left out" in text


def test_reports_link_to_what_is_in_the_zip_only(root: Path, tmp_path: Path) -> None:
    first, second, third = folders(root)
    other, evidence = folders(root, 4)[0], evidence_file_name(first.name, 0)
    bag_of(first, 0)
    for run in (first, second, other):
        (run / "report.html").write_text("somebody's")
    targets = [evidence, "metadata.yaml", "../x/../result.json", "#time"]
    targets += [f"../{run.name}/report.html" for run in (second, third, other)]

    def report(run: Path) -> tuple[dict[str, bytes], list[str]]:
        if run == second:
            return {}, ["report.html: cannot be made"]
        page = "".join(path_link(one, "<it>") for one in targets).replace("%23", "#")
        return {"report.html": page.encode()}, []

    target = tmp_path / "a.zip"
    made = export_team(
        collected_in(root),
        3,
        DEFAULT_MAPPINGS,
        NOW,
        target=target,
        parts=BagParts(evidence=False),
        report=report,
    )
    assert made.problems == (f"{second.name}/report.html: cannot be made",)
    there = unpacked(target, tmp_path / "there")
    gone = "<a>&lt;it&gt;</a> (not in this zip)"
    kept = [f'<a href="{target}">&lt;it&gt;</a>' for target in targets]
    assert (there / first.name / "report.html").read_text() == "".join(
        [gone, kept[1], gone, kept[3], kept[4], gone, gone]
    )
    assert not (there / second.name / "report.html").exists()
    assert not (there / third.name / "report.html").exists()


def test_a_zip_has_reports_as_they_are_now_and_never_a_copy(tmp_path: Path) -> None:
    first, second = put_recorded(tmp_path)
    flags = [f"--results={tmp_path}", "--output", str(tmp_path / "a.zip"), "--practice"]
    assert main(["export", "--subject=3", *flags]) == 0
    there = unpacked(tmp_path / "a.zip", tmp_path / "there")
    for run, other in ((first, second), (second, first)):
        page = (there / run.name / "report.html").read_text()
        assert "evil" not in page
        assert f'<a href="../{other.name}/report.html">' in page
        assert '<a href="result.json">' in page
    text = (there / "README.txt").read_text()
    assert re.search(r"\nAs of \d{4}-\d\d-\d\d \d\d:\d\d:\d\d UTC: ", text)
    for recording in second.glob("*.mcap"):
        recording.unlink()
    assert main(["export", "--subject=3", *flags]) == BAD_INPUT
    there = unpacked(tmp_path / "a.zip", tmp_path / "less")
    assert f"{second.name}/report.html: cannot be made: " in (there / "README.txt").read_text()
    assert [path.parent.name for path in there.rglob("report.html")] == [first.name]


def test_evidence_that_nobody_can_open_is_named_and_not_packed(root: Path, tmp_path: Path) -> None:
    run = folders(root)[0]
    bag_of(run, 0)
    (run / evidence_file_name(run.name, 1)).write_bytes(b"garbage")
    (run / evidence_file_name(run.name, 2)).touch()  # cut off before the first byte
    (run / f"{evidence_file_name(run.name, 0)}.torn").write_bytes(b"torn")
    made = export(root)
    (problem,) = made.problems
    assert problem == (
        f"{run.name}/{evidence_file_name(run.name, 1)}: is evidence that is not whole: "
        "`madrob recover` repairs it, then export again"
    )
    there = unpacked(made.path, tmp_path / "there")
    assert len(list(there.rglob("*evidence*"))) == 1
    assert opened_by_others(there / run.name)[1] == 4


def test_the_run_that_goes_on_is_left_out_and_named(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    going_on, done = folders(root)[2], folders(root)[1]
    (going_on / "result.json").unlink()
    with held(going_on), held(done):  # the engine holds a run until the next one is set up
        assert main(["export", "--subject=3", f"--results={root}"]) == 2
        said = capsys.readouterr()
        assert said.err == f"madrob: {going_on.name}: this run goes on: export again after it\n"
        made = Path(said.out.splitlines()[-1])
        for folder in folders(root)[:2]:
            (folder / "result.json").unlink()
    with zipfile.ZipFile(made) as packed:
        names = packed.namelist()
        assert f"{going_on.name}: this run goes on" in packed.read("README.txt").decode()
    assert not any(name.startswith(going_on.name) for name in names)
    assert any(name.startswith(done.name) for name in names)


def test_a_team_without_runs_is_told_in_a_line_and_makes_no_zip(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for team, words in (
        ("7", "there are runs of subject 3, 4"),
        ("999", "subject 999 has no runs"),
    ):
        assert main(["export", f"--subject={team}", f"--results={root}"]) == 2
        said = capsys.readouterr()
        assert said.err.count("\n") == 1
        assert words in said.err
    (only,) = folders(root, 4)
    (only / "result.json").unlink()
    with held(only), pytest.raises(MadrobError, match="only run of subject 4 goes on"):
        export_team(collected_in(root), 4, DEFAULT_MAPPINGS, NOW)
    assert not (root / "exports").exists()


def test_nothing_from_outside_and_nothing_half_written_is_packed(
    root: Path, tmp_path: Path
) -> None:
    secret = tmp_path / "secret.txt"
    secret.write_text("secret")
    first, second, third = folders(root)
    (first / "link.csv").symlink_to(secret)
    (first / "linked").symlink_to(tmp_path, target_is_directory=True)
    os.mkfifo(first / "pipe.csv")
    (second / ".report.html.1234.part").write_text("half")
    (second / "figures").mkdir()
    (second / "figures" / "door.svg").write_text("<svg/>")
    (root / third.name).rename(tmp_path / third.name)
    (root / third.name).symlink_to(tmp_path / third.name, target_is_directory=True)
    made = export(root)
    assert made.runs == 2
    assert made.problems == (
        f"{first.name}/linked: is a link",
        f"{first.name}/link.csv: cannot be read (it is a link)",
        f"{first.name}/pipe.csv: cannot be read (no plain file)",
    )
    with zipfile.ZipFile(made.path) as packed:
        assert f"{second.name}/figures/door.svg" in packed.namelist()
        assert not any("link" in name or ".part" in name for name in packed.namelist())
        assert b"secret" not in b"".join(packed.read(name) for name in packed.namelist())


@pytest.mark.machine
def test_damaged_run_folders_are_packed_as_they_are(root: Path, tmp_path: Path) -> None:
    first, second, third = folders(root)
    (first / "result.json").write_bytes(b"\xff{")
    for path in second.iterdir():
        path.unlink()
    (third / "back\\slash\nline.csv").write_text("odd")
    (third / "journal.jsonl").write_bytes(b"")
    (third / "bag_1.mcap").write_bytes(b"")
    os.utime(third / "bag_1.mcap", (0, 0))
    made = export(root)
    damaged, told = made.problems
    assert damaged.startswith(f"{first.name}: result.json is damaged")
    assert told.startswith(f"{third.name}: result.json is not what the journal says")
    with zipfile.ZipFile(made.path) as packed:
        assert "result.json is damaged" in packed.read("README.txt").decode()
    home = unpacked(made.path, tmp_path / "home")
    subprocess.run(["sha256sum", "-c", "--quiet", "SHA256SUMS"], cwd=home, check=True)


def test_names_that_lead_out_of_the_folder_or_steer_a_terminal_are_replaced_and_named(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = folders(root)[0]
    hostile = {
        "C:\\x.bat": "C__x.bat",
        "x\\..\\..\\evil.bat": "x_.._.._evil.bat",
        "esc\x1b]0;owned\x07\x1b[2J.txt": "esc.txt",
        "line\nbreak.csv": "line break.csv",
        "\u202etxt.exe": "txt.exe",
        "trailing. ": "trailing",
        "\x07": "_",
        "\x07\x07": "__2",
        "\x07..": "__3",
        "result\x07.json": "result_2.json",
    }
    for number, name in enumerate(hostile):
        (first / name).write_text(str(number))
    (first / "plain.csv").write_text("plain")
    (first / "..\\..\\hidden.bat").write_text("left out")
    (first / "C:").mkdir()
    (first / "C:" / "plain.csv").write_text("inside")
    target = tmp_path / "home.zip"
    assert main(["export", "--subject=3", f"--results={root}", f"--output={target}"]) == 0
    notes = [line for line in capsys.readouterr().out.splitlines() if line.startswith("note: ")]
    with zipfile.ZipFile(target) as packed:
        packed_names = packed.namelist()
        assert packed.read(f"{first.name}/result.json") == (first / "result.json").read_bytes()
        text = packed.read("README.txt").decode()
        for number, name in enumerate(hostile.values()):
            assert packed.read(f"{first.name}/{name}") == str(number).encode(), name
        assert packed.read(f"{first.name}/C_/plain.csv") == b"inside"
    assert f"{first.name}/plain.csv" in packed_names
    assert not any("hidden" in name for name in packed_names)
    assert len(notes) == len(hostile) + 1
    assert all(note.removeprefix("note: ") in text for note in notes)
    assert text.count("UNDER ANOTHER NAME") == 1


@given(st.lists(st.text(st.characters(exclude_characters="/\0"), min_size=1), unique=True))
def test_every_name_becomes_a_safe_one_of_its_own(names: list[str]) -> None:
    called = safe_names(names)
    assert set(called) == set(names)
    assert len(set(called.values())) == len(names)
    for name in called.values():
        assert name == name.strip(" .")
        assert name
        assert not set(name) & set("/\\:")
        assert name.isprintable() or not name.isascii()
    assert safe_names(called.values()) == {name: name for name in called.values()}


def test_folders_in_folders_without_end_are_named_and_the_rest_is_packed(root: Path) -> None:
    first = folders(root)[0]
    deep = first
    for _ in range(12):
        deep /= "d" * 60
        deep.mkdir()
        (deep / "file").write_text("deep")
    made = export(root)
    [problem] = made.problems
    assert problem.endswith(f"{'d' * 60}: too many folders, one in another")
    with zipfile.ZipFile(made.path) as packed:
        names = packed.namelist()
    assert max(map(len, names)) <= LONGEST_PATH
    assert sum("file" in name for name in names) == 5


def test_what_cannot_be_read_is_named_and_the_rest_is_packed(
    root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second, _ = folders(root)
    (first / os.fsdecode(b"\xff.csv")).write_text("no text")

    def vanishing(path: str, *, folder: int) -> int:
        if path == "metadata.yaml" and os.fstat(folder).st_ino == second.stat().st_ino:
            os.unlink(path, dir_fd=folder)
        return open_plain(path, folder=folder)

    monkeypatch.setattr("madrob_console.export.zip_file.open_plain", vanishing)
    assert main(["export", "--subject=3", f"--results={root}"]) == 2
    said = capsys.readouterr()
    lines = said.err.splitlines()
    assert len(lines) == 2
    assert lines[0].endswith(".csv: its name is no text")
    assert f"{second.name}/metadata.yaml: cannot be read (No such file" in lines[1]
    made = Path(said.out.splitlines()[-1])
    with zipfile.ZipFile(made) as packed:
        names = packed.namelist()
        assert lines[1].removeprefix("madrob: ") in packed.read("README.txt").decode()
        sums = packed.read("SHA256SUMS").decode()
    assert f"{second.name}/result.json" in names
    assert all(sums.count(f"  {name}\n") == 1 for name in names if name != "SHA256SUMS")


def test_a_file_that_shrinks_is_named_and_has_no_sum(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = folders(root)[0]
    fstat = os.fstat

    def larger(number: int) -> os.stat_result:
        found = fstat(number)
        values = list(found)
        if found.st_ino == (first / "metadata.yaml").stat().st_ino:
            values[6] += 10
        return os.stat_result(values)

    monkeypatch.setattr(os, "fstat", larger)
    made = export(root)
    assert made.problems == (
        f"{first.name}/metadata.yaml: its last 10 bytes cannot be read (it became shorter)",
    )
    with zipfile.ZipFile(made.path) as packed:
        assert f"{first.name}/metadata.yaml" not in packed.read("SHA256SUMS").decode()


def test_a_disk_that_refuses_leaves_no_half_zip(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zip_file.Archive, "finish", _full_disk)
    with pytest.raises(MadrobError, match=r"\.zip: not written \(No space left on device\)"):
        export(root)
    assert not (root / "exports").exists()


def _full_disk(*_arguments: object) -> None:
    raise OSError(28, "No space left on device")


def test_a_result_that_changes_meanwhile_is_named(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = folders(root)[0]
    add_folder = zip_file.Archive.add_folder

    def ruled(
        self: zip_file.Archive, folder: Path, called: str, without: Callable[[str], bool]
    ) -> None:
        add_folder(self, folder, called, without)
        if folder == first:
            (folder / "result.json").write_text("{}")

    monkeypatch.setattr(zip_file.Archive, "add_folder", ruled)
    assert export(root).problems == (f"{first.name}: its result changed meanwhile: export again",)


def text_in(made: pack.Export) -> str:
    with zipfile.ZipFile(made.path) as packed:
        return packed.read("README.txt").decode()


def test_the_text_says_how_each_run_ended(root: Path) -> None:
    write(root, summary(3, run_number=4, hour=5, outcome=Outcome.ABORTED, values={}))
    text = text_in(export(root))
    assert "condition 7, run 1: completed, not final; " in text
    assert "condition 7, run 4: aborted, not final\n" in text


def test_the_text_says_what_a_decision_on_a_run_hangs_on(root: Path) -> None:
    result = folders(root)[0] / "result.json"
    told = json.loads(result.read_text()) | {"flags": [msgspec.to_builtins(UNDECIDED_START)]}
    result.write_text(json.dumps(told))
    text = text_in(export(root))
    assert "run 1: completed, not final, 1 false start UNDECIDED (handle touched); " in text


def test_practice_runs_are_packed_apart_wherever_they_lie(root: Path) -> None:
    where_they_were = summary(3, run_number=4, hour=5, source="simulated")
    write(root, where_they_were)
    write(root / "practice", summary(3, run_number=1, hour=6, practice=True))
    moved = summary(3, run_number=2, hour=7)  # somebody put it there: it does not count either
    write(root / "practice", moved)
    official, practice = export(root), export(root, practice=True)
    assert (official.runs, practice.runs) == (3, 3)
    assert "PRACTICE" not in text_in(official)
    assert where_they_were.folder not in text_in(official)
    text = text_in(practice)
    assert text.startswith("MADROB: PRACTICE runs of subject 3 ")
    assert "condition 7, run 4: completed, not final, PRACTICE, simulated\n" in text
    assert "condition 7, run 1: completed, not final, PRACTICE\n" in text
    assert moved.folder in text
    assert "_practice_" in practice.path.name


@pytest.mark.parametrize("practice", [True, False])
def test_a_team_that_has_only_runs_of_the_other_kind_is_told_so(
    tmp_path: Path, *, practice: bool
) -> None:
    write(tmp_path, summary(3, practice=not practice))
    with pytest.raises(MadrobError, match="--practice"):
        export(tmp_path, practice=practice)
    assert not (tmp_path / "exports").exists()


@given(team=st.text(max_size=60), subject=st.integers(1, 999))
def test_every_team_name_gives_a_plain_file_name(team: str, subject: int) -> None:
    name = file_name(subject, team, EPOCH)
    assert name.startswith(f"team_{subject:03d}_")
    assert name.endswith(time.strftime("_%Y%m%d_%H%M%S.zip", time.localtime(EPOCH)))
    assert len(f".{name}.12345678.part".encode()) <= 255
    assert all(char in "_-." or unicodedata.category(char)[0] in "LN" for char in name)


def test_the_layout_shows_the_topics_of_the_testbed() -> None:
    own = TopicMapping(
        Signal.HANDLE, "/door/handle", "madrob_msgs/msg/Handle", "force", scale=0.0098
    )
    mappings = [own, *(m for m in DEFAULT_MAPPINGS if m.signal is not Signal.HANDLE)]
    layout = foxglove_layout(mappings)
    plots = [p for key, p in layout["configById"].items() if key.startswith("Plot!")]
    lines = {line["value"]: line["label"] for plot in plots for line in plot["paths"]}
    assert lines["/madrob/door/angle.position[0]"] == "angle, rad"
    assert lines["/door/handle.force"] == "force, N, as published"
    assert lines["/madrob/passage/ccw_right.ranges[0]"] == "ccw 4, distance down"
    assert len([value for value in lines if value.startswith("/")]) == 13
    assert set(layout) == {"configById", "layout", "globalVariables", "userNodes", "playbackConfig"}
    assert _panels(layout["layout"]) == set(layout["configById"])


def test_the_layout_goes_by_the_messages_own_stamps_and_has_the_thresholds_as_published() -> None:
    own = TopicMapping(Signal.HANDLE, "/door/handle", "geometry_msgs/msg/WrenchStamped",
                       "wrench.force.x", scale=0.5, offset=1.0)  # fmt: skip
    mappings = [own, *(m for m in DEFAULT_MAPPINGS if m.signal is not Signal.HANDLE)]
    limits = Thresholds(closed_angle=0.04, touch_force=3.0, lintel_height=2.5, present_height=0.4)
    layout = foxglove_layout(mappings, limits, HandleZero(6.0, "run 2 of condition 1"))
    paths = [path for panel in layout["configById"].values() for path in panel.get("paths", ())]
    assert {p["timestampMethod"] for p in paths if p["value"].startswith("/madrob/passage")} == {
        "headerStamp"
    }
    methods = {path["value"]: path["timestampMethod"] for path in paths}
    assert methods["/madrob/door/angle.position[0]"] == "headerStamp"
    assert methods["/madrob/door/locked.data"] == "receiveTime"  # it has no stamp
    levels = [float(path["value"]) for path in paths if not path["value"].startswith("/")]
    assert sorted(levels) == [-0.04, 0.04, 2.1, 2.1, 4.0, 16.0]
    words = {path["value"]: path["label"] for path in paths}
    assert words["16"] == "touch, 3.00 N from the zero (6.00 N, run 2 of condition 1)"


def test_the_layout_shows_phases_and_events_in_their_own_words() -> None:
    layout = foxglove_layout(DEFAULT_MAPPINGS)
    shown = {path["value"] for path in layout["configById"]["StateTransitions!course"]["paths"]}
    for script in layout["userNodes"].values():
        (output,) = re.findall(r'export const output = "(.*)";', script["sourceCode"])
        (heard,) = re.findall(r'export const inputs = \["(.*)"\];', script["sourceCode"])
        assert f"{output}.word" in shown
        assert heard in {topic.name for topic in referee_topics(MessageTypes())}
    panels = layout["configById"].values()
    read = {panel["topicPath"] for panel in panels if "topicPath" in panel}
    assert read == {REFEREE_EVENT_TOPIC, REFEREE_STATE_TOPIC}
    doorway = layout["configById"]["3D!doorway"]
    assert doorway["followTf"] == START_POSE_FRAME
    scans = {mapping.topic for mapping in DEFAULT_MAPPINGS if "LaserScan" in mapping.type}
    assert set(doorway["topics"]) == {*scans, REFEREE_START_POSE_TOPIC}


def test_the_layout_in_a_zip_has_the_handle_zero_of_the_newest_run(
    recorded: Path, tmp_path: Path
) -> None:
    found = collected_in(recorded)
    export_team(found, 3, DEFAULT_MAPPINGS, NOW, practice=True, target=tmp_path / "a.zip")
    home = unpacked(tmp_path / "a.zip", tmp_path / "home")
    layout = json.loads((home / "madrob_foxglove_layout.json").read_text())
    (_, above, below) = layout["configById"]["Plot!handle"]["paths"]
    zero = (float(above["value"]) + float(below["value"])) / 2
    assert zero == pytest.approx(5.9, abs=0.1)
    assert f"({zero:.2f} N, run " in above["label"]


def _panels(node: object) -> set[str]:
    """The panels of a layout's tree."""
    if isinstance(node, str):
        return {node}
    assert isinstance(node, dict)
    assert node["direction"] in ("row", "column")
    return _panels(node["first"]) | _panels(node["second"])


def test_a_file_beyond_the_limits_of_old_zips_is_packed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zipfile, "ZIP64_LIMIT", 1_000_000)  # as if it had four gigabytes
    folder = tmp_path / "run"
    folder.mkdir()
    with (folder / "large.mcap").open("wb") as file:
        file.truncate(3_000_000)
    with (tmp_path / "a.zip").open("wb") as out, zip_file.Archive(out) as packed:
        packed.add_folder(folder, "run")
        assert list(packed.sums) == ["run/large.mcap"]
        packed.finish(NOW)
    with zipfile.ZipFile(tmp_path / "a.zip") as read:
        data = read.read("run/large.mcap")
        assert read.read("SHA256SUMS").decode().split()[0] == hashlib.sha256(data).hexdigest()
    assert len(data) == 3_000_000


CAMERA = RecordedTopic("/camera/c1", "raw/Type", 90, 4_000_000, 0, {EvidenceLoss.BEHIND: 14})


def told(**fields: object) -> list[str]:
    return list(protest_lines(Run(**fields), "the_run"))  # type: ignore[arg-type]


def test_who_decides_a_protest_reads_what_of_the_evidence_is_missing_and_when() -> None:
    gaps = EvidenceGap(6.7, 8.6, "the process ended"), EvidenceGap(20.0, None, "the disk")
    lines = told(evidence=EvidenceAccount((CAMERA,), gaps=gaps))
    lost = "at least 14 lost, missing from +6.7 s to +8.6 s and 1 time more"
    assert lines[-3:] == [
        f"Evidence: 1 topic, 90 messages, 4.0 MB, {lost}",
        "  missing from +6.7 s to +8.6 s, from +20.0 s to the end",
        "  /camera/c1: at least 14 lost (14 behind)",
    ]


def test_evidence_that_was_removed_is_called_so() -> None:
    lines = told(
        evidence=EvidenceAccount((CAMERA,)), removed_evidence=(RemovedEvidence(0.0, 1, 5),)
    )
    assert "  removed by tidy on 1970-01-01 00:00:00 UTC" in lines


def test_a_run_without_evidence_says_nothing_of_it() -> None:
    assert not any("vidence" in line for line in told())


def filed(about: str) -> Protest:
    return Protest(1, 107.5, "Graz", "too late", about, 107.5, "R. Eferee")


def test_a_time_that_a_protest_is_about_is_told_once() -> None:
    lines = told(protests=(filed("7.500 s"), filed("step 4")), start=100.0)
    assert [line.split(maxsplit=1)[1] for line in lines if "about:" in line] == [
        "7.500 s from the start",
        "step 4, 7.500 s from the start",
    ]


@pytest.mark.parametrize(("team", "whose"), [("", "subject 3"), ("Graz", "subject 3 Graz")])
def test_whose_run_it_is_stands_below_the_title(team: str, whose: str) -> None:
    assert told(setup=replace(make_setup(), team=team))[1].startswith(
        f"Run 1 of {whose}, condition "
    )
