"""`madrob export`: the zip that a team takes home."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import time
import unicodedata
import zipfile
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import jsonschema
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.rosbag2 import Reader

from madrob_console.archive.collection import collected_in
from madrob_console.archive.folders import run_folder_names
from madrob_console.common.errors import MadrobError
from madrob_console.common.file_locks import Hold
from madrob_console.common.names import terminal_safe
from madrob_console.export import pack, zip_file
from madrob_console.export.contents import file_name, team_contents
from madrob_console.export.pack import BagParts
from madrob_console.export.papers import protests_text
from madrob_console.export.zip_file import LONGEST_PATH
from madrob_console.referee.evidence import Evidence, EvidenceTopic
from madrob_console.referee.journal import HOLD_FILE
from madrob_console.referee.protests import Protest
from madrob_console.referee.run import Run
from madrob_console.testbeds.simulated import Scenario
from recorder.reader import Bag
from scoring.protocol import Outcome
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.recorded_runs import list_files, recorded
from tests.madrob_console.run_folders import EPOCH, UNDECIDED_START, summary, write
from tests.recorder.samples import add_evidence, by_library, strings

NOW = 1_790_000_000.0
JOINTS = "time,position,velocity,acceleration\n"


@pytest.fixture(scope="module")
def recorded_root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results folder with a recorded practice run of team 3."""
    source = recorded(Scenario.TOUCH_ONLY)
    root = tmp_path_factory.mktemp("recorded")
    shutil.copytree(source, root / "practice" / source.name)
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
        (folder / f"{folder.name[:28]}_jointState.csv").write_text(f"{JOINTS}1,2,0,0\n")
    return root


def folders(root: Path, subject: int = 3) -> list[Path]:
    names = run_folder_names(root)
    return sorted(root / name for name in names if f"subject_{subject:03d}" in name)


Report = tuple[dict[str, bytes], list[str]]


def export(
    root: Path,
    report: Callable[[Path], Report] = lambda _: ({"report.html": b"page"}, []),
    *,
    bags: bool = True,
    practice: bool = False,
) -> pack.Export:
    contents = team_contents(collected_in(root), 3, NOW, practice=practice)
    return pack.pack(contents, report, parts=BagParts(bags))


TEAM_3 = "export --subject 3 --results"
PRACTICE = "export --practice --subject 3 --results"


def read(path: Path) -> dict[str, bytes]:
    """The files of a zip."""
    with zipfile.ZipFile(path) as packed:
        assert packed.testzip() is None
        return {name: packed.read(name) for name in packed.namelist()}


def unpacked(path: Path, target: Path) -> Path:
    """A clean folder with what is in a zip."""
    shutil.unpack_archive(path, target)
    return target


@pytest.mark.machine
def test_a_team_opens_every_file_of_its_zip_as_the_text_in_it_says(
    recorded_root: Path, tmp_path: Path, madrob: Madrob
) -> None:
    target = tmp_path / "home.zip"
    said = madrob.say(PRACTICE, recorded_root, "--output", target)
    assert (said.code, said.out.splitlines()[-1], said.err) == (0, str(target), "")
    home = unpacked(target, tmp_path / "home")
    sums = subprocess.check_output(["sha256sum", "-c", "SHA256SUMS"], cwd=home, text=True)
    assert sums.count(": OK") == sum(path.is_file() for path in home.rglob("*")) - 1
    (run,) = recorded_root.glob("practice/*")
    assert all(
        (home / run.name / one.name).read_bytes() == one.read_bytes() for one in run.iterdir()
    )
    text = (home / "README.txt").read_text()
    assert f"ros2 bag play {run.name}\n" in text
    assert len(list(Bag(home / run.name).messages())) > 1000
    schema = json.loads((home / "madrob_result_schema_1.json").read_text())
    jsonschema.validate(json.loads((home / run.name / "result.json").read_text()), schema)


def test_only_the_teams_official_runs_are_packed_oldest_first_into_the_same_bytes(
    root: Path,
) -> None:
    write(root, summary(3, run_number=4, hour=9, team="TEST", source="simulated"))
    runs, exported = run_folder_names(root), export(root)
    data, names = exported.path.read_bytes(), list(read(exported.path))
    packed_runs = list(dict.fromkeys(name.split("/")[0] for name in names if "/" in name))
    assert packed_runs == [folder.name for folder in folders(root)[:3]]
    assert names[-3:] == [
        "madrob_result_schema_1.json",
        "README.txt",
        "SHA256SUMS",
    ]
    zipped = root / "exports" / file_name(3, "Team 3", NOW)
    assert exported == pack.Export(zipped, 3, len(names), len(data), ())
    assert export(root).path.read_bytes() == data
    assert sorted(run_folder_names(root)) == sorted(runs)  # zips are no runs


@pytest.mark.parametrize("dossier", [False, True])
def test_the_legend_explains_each_column_of_every_table(
    *, dossier: bool, recorded_root: Path, tmp_path: Path, madrob: Madrob
) -> None:
    (run,) = recorded_root.glob("practice/*")
    target = tmp_path / "a.zip"
    line = ("export --dossier --run", run) if dossier else (PRACTICE, recorded_root)
    madrob(*line, "--output", target)
    packed, start = read(target), json.loads((run / "result.json").read_text())["start"]
    legend = packed["COLUMNS.txt"].decode()
    tables = {n: pd.read_csv(BytesIO(data)) for n, data in packed.items() if n.endswith(".csv")}
    assert {"runs.csv", "indicators.csv", "events.csv", "steps.csv"} <= set(tables)
    assert any(name.startswith("tables/") for name in tables) == dossier
    for name, table in tables.items():
        assert all(re.search(rf"\b{column}\b", legend) for column in table.columns), name
        if "time" in table and not name.startswith(run.name):  # EUROBENCH defines those
            seconds = (table.time - start).round(6)
            assert table.since_start.to_numpy() == pytest.approx(seconds, abs=1e-6, nan_ok=True)
    assert tables["runs.csv"].place.tolist() == [run.name]


def test_page_and_text_lead_to_what_is_there_and_say_how_each_run_ended(root: Path) -> None:
    team = "<b>Team\x1b]0;owned\x07"
    write(root, summary(3, run_number=4, hour=5, outcome=Outcome.ABORTED, values={}, team=team))
    write(root, summary(3, run_number=5, hour=6, flags=(UNDECIDED_START,), team=team))
    write(root, summary(3, run_number=6, hour=7, testbed="Hall A", run_id="0193a", team=team))
    for run in folders(root)[:2]:
        (run / "report.html").touch()
    packed = read(export(root).path)
    page, text = packed["index.html"].decode(), packed["README.txt"].decode()
    assert "<h1>MADROB: runs of subject 3 &lt;b&gt;Team</h1>" in page
    led = set(re.findall(r'<a href="([^"]+)"', page))
    assert led <= set(packed)
    assert {f"{folders(root)[0].name}/report.html", "runs.csv", "COLUMNS.txt"} <= led
    assert page.count("17.4320") == 5
    for words in ("completed, not final", "aborted, not final"):
        assert words in page
    for words in (
        "run 6: completed, not final; Hall A; 0193a\n",
        "run 4: aborted, not final\n",
        "run 5: completed, not final, 1 false start UNDECIDED (handle touched)\n",
    ):
        assert f"condition 7, {words}" in text


FRAMES = strings(["a picture", "another"])


def bag_of(folder: Path, *numbers: int) -> int:
    """A real bag with evidence in place of that of a run; how many messages its recording has."""
    (folder / f"{folder.name}_0.mcap").write_bytes(by_library(FRAMES))
    for number in numbers:
        add_evidence(folder, FRAMES, number)
    list_files(folder)
    return len(FRAMES)


@pytest.mark.parametrize("evidence", [True, False])
def test_evidence_is_packed_or_left_out_and_the_bag_reads_the_same(
    *, evidence: bool, root: Path, tmp_path: Path, madrob: Madrob
) -> None:
    run = folders(root)[0]
    count = bag_of(run, 1, 2)
    said = madrob.say(TEAM_3, root, *([] if evidence else ["--without-evidence"]))
    there = unpacked(Path(said.out.splitlines()[-1]), tmp_path / "there")
    with Reader(there / run.name) as reader:
        assert sum(1 for _ in reader.messages()) == count
    bags = [f"{run.name}_evidence", f"{run.name}_evidence_2"] if evidence else []
    assert sorted(path.name for path in (there / run.name).glob("*evidence*")) == bags
    for bag in bags:
        with Reader(there / run.name / bag) as reader:
            assert sum(1 for _ in reader.messages()) == len(FRAMES)
    text = (there / "README.txt").read_text()
    left_out = "NOT IN THIS ARCHIVE\n  the evidence was left out on demand\n"
    assert (left_out in text) != evidence
    plain = read(export(root, bags=False).path)
    assert not any("evidence" in name for name in plain)
    assert b"the recordings were left out on demand" in plain["README.txt"]


def test_only_reports_of_the_runs_as_they_are_now_are_packed(root: Path) -> None:
    first, second, _ = folders(root)
    for run in (first, second):
        (run / "report.html").write_text("somebody's")
    reports = {first: ({"report.html": b"page"}, []), second: ({}, ["report.html: cannot be made"])}
    exported = export(root, lambda run: reports.get(run, ({}, [])))
    assert exported.problems == (f"{second.name}/report.html: cannot be made",)
    packed = {name: data for name, data in read(exported.path).items() if "report.html" in name}
    assert packed == {f"{first.name}/report.html": b"page"}


def test_the_run_that_goes_on_is_left_out_and_named(root: Path, madrob: Madrob) -> None:
    first, done, going_on = folders(root)
    (going_on / "result.json").unlink()
    # the engine holds a run until the next one is set up
    with Hold(going_on / HOLD_FILE), Hold(done / HOLD_FILE):
        said = madrob.say(TEAM_3, root)
    line = f"{going_on.name}: this run goes on"
    assert (said.code, said.err) == (2, f"madrob: {line}: export again after it\n")
    packed = read(Path(said.out.splitlines()[-1]))
    assert line in packed["README.txt"].decode()
    assert {name.split("/")[0] for name in packed if "/" in name} == {first.name, done.name}


@pytest.mark.parametrize(
    ("team", "words"),
    [
        (7, "there are runs of subject 3, 4"),
        (999, "subject 999 has no runs"),
        (4, "only run of subject 4 goes on"),
        (5, "--practice"),
    ],
)
def test_a_team_without_runs_to_pack_is_told_in_a_line_and_makes_no_zip(
    team: int, words: str, root: Path, madrob: Madrob
) -> None:
    (only,) = folders(root, 4)
    (only / "result.json").unlink()
    write(root, summary(5, practice=True))
    with Hold(only / HOLD_FILE):
        assert words in madrob.refusal(f"export --subject {team} --results", root)
    assert not (root / "exports").exists()


UNSAFE = (
    *("C:\\x.bat", "x\\..\\..\\evil.bat", "esc\x1b]0;owned\x07\x1b[2J.txt", "line\nbreak.csv"),
    *("\u202etxt.exe", "trailing. ", "\x07", "\x07..", "result\x07.json", "C:"),
    os.fsdecode(b"\xff.csv"),
)


def put_file(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("somebody's")


DEEP = "/".join(["d" * 60] * 12)
Spoil = Callable[[Path], object]
SPOILT: dict[str, tuple[Spoil, list[str]]] = {
    "a link to a file": (
        lambda run: (run / "link.csv").symlink_to("/etc/passwd"),
        ["/link.csv: cannot be read (it is a link)"],
    ),
    "a link to a folder": (lambda run: (run / "linked").symlink_to("/etc"), ["/linked: is a link"]),
    "a pipe": (
        lambda run: os.mkfifo(run / "pipe.csv"),
        ["/pipe.csv: cannot be read (no plain file)"],
    ),
    "half a file": (lambda run: (run / ".report.html.1234.part").write_text("half"), []),
    "a folder": (lambda run: put_file(run / "figures" / "door.svg"), []),
    "folders without end": (
        lambda run: put_file(run / DEEP / "file"),
        [f"/{'/'.join(['d' * 60] * 6)}: too many folders, one in another"],
    ),
    "a result that is damaged": (
        lambda run: (run / "result.json").write_bytes(b"\xff{"),
        [": result.json is damaged"],
    ),
    "a journal that is empty": (
        lambda run: (run / "journal.jsonl").write_bytes(b""),
        [": result.json is not what the journal says"],
    ),
    "names that lead out or steer a terminal": (
        lambda run: list(
            map(put_file, [run / n for n in (*UNSAFE, "plain.csv", "..\\..\\hidden.bat")])
        ),
        [": its name cannot be unpacked everywhere: rename it"] * len(UNSAFE),
    ),
    "no files": (
        lambda run: list(map(Path.unlink, filter(Path.is_file, run.rglob("*")))),
        [],
    ),
    "an old recording": (lambda run: os.utime(next(run.glob("*_0.mcap")), (0, 0)), []),
}


@pytest.mark.parametrize("case", SPOILT)
def test_what_is_spoilt_or_not_of_the_run_is_named_and_the_rest_is_packed(
    case: str, root: Path
) -> None:
    first, *others = folders(root)
    bag_of(first, 1)
    spoil, problems = SPOILT[case]
    spoil(first)
    exported = export(root)
    assert [words.startswith(first.name) for words in exported.problems] == [True] * len(problems)
    assert all(why in words for why, words in zip(problems, exported.problems, strict=True))
    packed = read(exported.path)
    text, sums = packed["README.txt"].decode(), packed["SHA256SUMS"].decode().splitlines()
    assert all(terminal_safe(words) in text for words in exported.problems)
    assert {f"{other.name}/result.json" for other in others} <= set(packed)
    assert max(map(len, packed)) <= LONGEST_PATH
    assert not [name for name in packed if "link" in name or name.endswith((".part", ".torn"))]
    assert b"root:" not in b"".join(packed.values())
    own = {
        "a folder": ["figures/door.svg"],
        "names that lead out or steer a terminal": ["plain.csv"],
    }
    assert [name for name, data in packed.items() if data == b"somebody's"] == [
        f"{first.name}/{name}" for name in own.get(case, [])
    ]
    assert all(packed[f"{first.name}/{t.name}"] == t.read_bytes() for t in first.glob("*State.csv"))
    evidence = [name for name in packed if "_evidence/" in name]
    assert len(evidence) == (0 if case == "no files" else 2)
    told = {name: hashlib.sha256(data).hexdigest() for name, data in packed.items()}
    del told["SHA256SUMS"]
    assert sorted(sums) == sorted(f"{digest}  {name}" for name, digest in told.items())


def test_a_file_that_shrinks_is_named_and_has_no_sum(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, fstat = folders(root)[0], os.fstat
    shrinking = (first / "metadata.yaml").stat().st_ino

    def larger(number: int) -> os.stat_result:
        values = list(fstat(number))
        values[6] += 10 if values[1] == shrinking else 0
        return os.stat_result(values)

    monkeypatch.setattr(os, "fstat", larger)
    exported = export(root)
    assert exported.problems == (
        f"{first.name}/metadata.yaml: its last 10 bytes cannot be read (it became shorter)",
    )
    assert f"{first.name}/metadata.yaml" not in read(exported.path)["SHA256SUMS"].decode()


def test_a_disk_that_refuses_leaves_no_half_zip(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    full = Mock(side_effect=OSError(28, "No space left on device"))
    monkeypatch.setattr(zip_file.Archive, "finish", full)
    with pytest.raises(MadrobError, match=r"\.zip: not written \(No space left on device\)"):
        export(root)
    assert not (root / "exports").exists()


def test_a_result_that_changes_meanwhile_is_named(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = folders(root)[0]
    add_folder = zip_file.Archive.add_folder

    def ruled(self: zip_file.Archive, folder: Path, called: str, *rest: Callable[..., Any]) -> None:
        add_folder(self, folder, called, *rest)
        if folder == first:
            (folder / "result.json").write_text("{}")

    monkeypatch.setattr(zip_file.Archive, "add_folder", ruled)
    assert export(root).problems == (f"{first.name}: its result changed meanwhile: export again",)


def test_practice_runs_are_packed_apart_wherever_they_lie(root: Path) -> None:
    where_they_were = summary(3, run_number=4, hour=5, source="simulated")
    moved = summary(3, run_number=2, hour=7)  # somebody put it there: it does not count either
    write(root, where_they_were)
    write(root / "practice", summary(3, run_number=1, hour=6, practice=True))
    write(root / "practice", moved)
    official, practice = export(root), export(root, practice=True)
    assert (official.runs, practice.runs, "_practice_" in practice.path.name) == (3, 3, True)
    assert not re.search(
        f"PRACTICE|{where_they_were.folder}", read(official.path)["README.txt"].decode()
    )
    text = read(practice.path)["README.txt"].decode()
    assert text.startswith("MADROB: PRACTICE runs of subject 3 ")
    for words in (
        "condition 7, run 4: completed, not final, PRACTICE, simulated\n",
        "condition 7, run 1: completed, not final, PRACTICE\n",
        moved.folder,
    ):
        assert words in text


@given(team=st.text(max_size=60), subject=st.integers(1, 999))
def test_every_team_name_gives_a_plain_file_name(team: str, subject: int) -> None:
    name = file_name(subject, team, EPOCH)
    assert name.startswith(f"team_{subject:03d}_")
    assert name.endswith(time.strftime("_%Y%m%d_%H%M%S.zip", time.localtime(EPOCH)))
    assert len(f".{name}.12345678.part".encode()) <= 255
    assert all(char in "_-." or unicodedata.category(char)[0] in "LN" for char in name)


def test_a_file_beyond_the_limits_of_old_zips_is_packed(
    root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.truncate(next(folders(root)[0].glob("*.mcap")), 3_000_000)
    plain = read(export(root).path)
    monkeypatch.setattr(zipfile, "ZIP64_LIMIT", 1_000_000)  # as if it had four gigabytes
    assert read(export(root).path) == plain


SETUP = make_setup()


def filed(about: str) -> Protest:
    return Protest(1, 107.5, "Graz", "too late", about, 107.5, "R. Eferee")


PROTESTS: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "evidence is missing": (
        {"evidence": Evidence({"/camera/c1": EvidenceTopic(90, 14, 103.0)}), "start": 100.0},
        (
            "Evidence: 1 topic, 90 messages, 14 lost",
            "  /camera/c1: 14 messages lost",
            "  /camera/c1: silent since +3.0 s",
        ),
    ),
    "a time is told once": (
        {"protests": (filed("7.500 s"), filed("step 4")), "start": 100.0},
        ("about:     7.500 s from the start", "about:     step 4, 7.500 s from the start"),
    ),
    "a team with a name": (
        {"setup": replace(SETUP, team="Graz")},
        ("Run 1 of subject 3 Graz, condition ",),
    ),
    "a team without one": (
        {"setup": replace(SETUP, team="")},
        ("Run 1 of subject 3, condition ",),
    ),
}


@pytest.mark.parametrize("case", PROTESTS)
def test_who_decides_a_protest_reads_whose_run_it_is_and_what_is_missing(
    case: str,
) -> None:
    fields, words = PROTESTS[case]
    lines = protests_text([(Run(**fields), "the_run")]).decode().splitlines()
    plain = [" ".join(line.split()) for line in lines]
    assert [each for each in words if not any(" ".join(each.split()) in one for one in plain)] == []
    assert any("vidence" in line for line in lines) == ("evidence" in fields)
    assert sum("7.500 s" in line for line in lines) == 2 * ("protests" in fields)
