"""Runs of any number of results folders and testbeds, at any depth, each once."""

from __future__ import annotations

import os
import shutil
import zipfile
from pathlib import Path
from typing import Any

import pytest

from madrob_console.archive.collection import collected, collected_in
from madrob_console.archive.history import RunSummary
from madrob_console.archive.run_paths import all_runs_at, runs_at
from madrob_console.cli.main import main
from madrob_console.cli.problems import BAD_INPUT
from madrob_console.errors import MadrobError
from madrob_console.standings.competition import competition_standings
from madrob_console.standings.testbeds_apart import how_testbeds_differ
from tests.madrob_console.run_folders import summary, write

HALLS = {"Hall A": "a", "Hall B": "merged/halls/b"}
SAME_NAME = "subject_003_cond_007_run_001"


def run_id(hall: str, number: int) -> str:
    return f"018b{ord(hall[-1]):04x}-0000-7000-8000-{number:012d}"


@pytest.fixture
def halls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two testbeds with two runs each; the folders of one are called like those of the other."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    for hall, place in HALLS.items():
        for number in (1, 2):
            told: dict[str, Any] = {"testbed": hall, "run_id": run_id(hall, number), "rate": 50.0}
            write(Path(place), summary(3, run_number=number, hour=number, **told))
    return tmp_path


def test_all_commands_find_runs_at_any_depth_and_those_at_two_paths_once(halls: Path) -> None:
    found = all_runs_at([Path("merged"), Path("a"), Path("merged/halls")])
    assert [run.path.parent for run in found] == [Path("merged/halls/b")] * 2 + [Path("a")] * 2
    (halls / "a" / "around").symlink_to("..")
    (halls / "a" / ".kept").mkdir()
    shutil.copytree("merged", "a/.kept/merged")
    assert [run.path.parent for run in runs_at(Path("a"))] == [Path("a")] * 2


def test_runs_of_two_testbeds_with_one_folder_name_are_both_kept(halls: Path) -> None:
    found = collected([Path("a"), Path("merged")])
    assert [(run.testbed, run.run_number) for run in found.runs] == [
        ("Hall A", 1),
        ("Hall B", 1),
        ("Hall A", 2),
        ("Hall B", 2),
    ]
    assert all((found.root / run.folder / "result.json").exists() for run in found.runs)
    assert not found.twins
    assert not found.unlisted
    (made,) = competition_standings(found.runs, made=0.0).groups
    assert (made.overall[0].completed, made.overall[0].testbeds) == (4, ("Hall A", "Hall B"))


def test_the_same_run_met_twice_counts_once_and_both_places_are_named(halls: Path) -> None:
    first = next(Path("a").glob(f"{SAME_NAME}*"))
    again = Path("copies") / first.name.replace("_22", "_21").replace("_23", "_22")
    shutil.copytree(first, again)
    for paths in ([Path("a"), Path("copies")], [Path("copies"), Path("a")]):
        found = collected(paths)
        (remark,) = found.twins
        assert str(first) in remark
        assert str(again) in remark
        (made,) = competition_standings(found.runs, made=0.0).groups
        assert made.overall[0].completed == 2
    shutil.copytree(first, Path("a") / again.name)  # in the results folder itself
    found = collected_in(Path("a"))
    assert [run.outcome_word for run in found.runs].count("TWICE") == 1
    (left_out,) = competition_standings(found.runs, made=0.0).left_out
    assert first.name in left_out.why
    assert again.name in left_out.why


def test_of_a_run_that_is_there_twice_the_latest_issue_counts(halls: Path) -> None:
    told: dict[str, Any] = {"testbed": "Hall A", "run_id": run_id("Hall A", 1), "issue": 2}
    write(Path("later"), summary(3, run_number=1, hour=1, **told))
    for paths in (["a", "later"], ["later", "a"]):
        (twin,) = (run for run in collected(list(map(Path, paths))).runs if run.twin)
        assert (twin.issue, Path(twin.twin).parent) == (1, Path("later"))


def test_one_testbed_can_be_asked_for(halls: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert {run.testbed for run in collected([halls], "Hall B").runs} == {"Hall B"}
    with pytest.raises(MadrobError, match=r"'Hall C'.*there are 'Hall A', 'Hall B'"):
        collected([halls], "Hall C")
    assert main(["standings", "a", "merged", "--testbed-name", "Hall B", "--csv", "-"]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert rows[1].split(",")[8:11] == ["Hall B", "Autumn Cup", "2"]


def test_what_is_in_no_list_is_named_with_what_to_do_and_the_rest_is_there(
    halls: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(MadrobError, match="no such folder"):
        collected([Path("none")])
    run = next(Path("a").glob(f"{SAME_NAME}*"))
    for name in ("final", "bag", "locked", "empty"):
        Path(name).mkdir()
    shutil.copy(run / "result.json", "final")
    for recording in (Path("final") / f"{run.name}_0.mcap", Path("bag/b_0.mcap"), Path("b.mcap")):
        recording.touch()
    Path("locked").chmod(0)
    Path("linked").mkdir()
    Path("linked", run.name).symlink_to(run.absolute())
    named = ["final", "bag", "b.mcap", "locked", "empty", f"linked/{run.name}"]
    expected = {
        "final": f"is not called like a run and left out: call it {run.name} again",
        "bag": "has no result.json of a run folder: name folders with runs",
        "b.mcap": "is no run folder: name folders with runs",
        "locked": "cannot be read (Permission denied): check its permissions",
        "empty": "holds no run: name folders with runs",
        f"linked/{run.name}": "is behind a link and left out: name the folder itself",
    }
    Path("plan.csv").write_text("3,7,6\n")
    if os.access("locked", os.R_OK):  # root reads everything
        named.remove("locked")
        del expected["locked"]
    for command in (
        ["standings"],
        ["plan", "--plan", "plan.csv"],
        ["export", "--subject", "3", "--output", "team.zip"],
    ):
        assert main([*command, *named, "a"]) == BAD_INPUT
        told = capsys.readouterr()
        assert sorted(told.err.splitlines()) == sorted(
            f"madrob: {place}: {why}" for place, why in expected.items()
        )
        assert told.out
    Path("b.mcap").unlink()  # in a folder with a bag, the bag is the run
    below = collected([Path()])
    assert {Path(place).name for place, _ in below.unlisted} == set(expected) & {"final", "bag"}


@pytest.mark.parametrize("named", [".", "../practice", "{run}", "../practice/{run}"])
def test_a_run_is_found_from_whatever_folder_it_is_named(
    halls: Path, named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = write(Path("c/practice"), summary(4, source="simulated"))
    monkeypatch.chdir(result.parent if named == "." else result.parent.parent)
    (run,) = collected([Path(named.format(run=result.parent.name))]).runs
    assert run.practice
    assert (run.folder, run.subject, run.problem) == (run.folder, 4, None)


def test_a_damaged_run_is_named_by_standings_and_plan_and_the_exit_code_says_so(
    halls: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    damaged = next(Path("a").glob("*_run_002_*"))
    (damaged / "result.json").write_text("{")
    Path("plan.csv").write_text("3,7,6\n")
    for command in (["standings"], ["plan", "--plan", "plan.csv"]):
        assert main([*command, "a", "merged"]) == BAD_INPUT
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"madrob: {damaged}: result.json is damaged")


def test_standings_of_practice_alone_say_how_to_see_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    for number in (1, 2):
        write(tmp_path / "c", summary(4, run_number=number, source="simulated", practice=True))
    assert main(["standings", str(tmp_path / "c")]) == 0
    said = "madrob: note: no official run, 2 of practice: --practice shows them\n"
    assert capsys.readouterr().err == said
    assert main(["standings", "--practice", str(tmp_path / "c")]) == 0
    assert capsys.readouterr().err == ""


def test_testbeds_that_differ_say_so_in_one_line() -> None:
    def runs(hall: str, **told: object) -> list[RunSummary]:
        every: dict[str, Any] = {**told, "testbed": hall}
        return [summary(3, run_number=n, **every) for n in (1, 2)]

    same = [*runs("A", rate=49.98, thresholds={}), *runs("B", rate=50.02, thresholds={})]
    assert how_testbeds_differ(same) == ""
    assert how_testbeds_differ(runs("A", rate=50.0)) == ""
    other = runs("B", rate=100.0, thresholds={"touch_force": 3.0}, ruleset="robust-2026")
    assert how_testbeds_differ([*runs("A", rate=50.0, thresholds={}), *other]) == (
        "The testbeds differ: ruleset protocol (A), robust-2026 (B); sampling rate 50 Hz (A), "
        "100 Hz (B); touch_force 1.96133 (A), 3 (B)."
    )
    assert "thresholds" not in how_testbeds_differ([*runs("A", rate=50.0), *other])


def test_standings_plan_and_export_take_several_folders(
    halls: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(
        next(Path("a").glob(f"{SAME_NAME}*")), Path("b") / f"{SAME_NAME}_20200101_000000"
    )
    every = ["a", "merged", "b"]
    assert main(["standings", *every]) == 0
    said = capsys.readouterr().out
    assert "3 Team 3: 4 completed; on Hall A, Hall B" in said
    assert "TWICE: " in said
    Path("plan.csv").write_text("3,7,6\n")
    Path("madrob.toml").write_text('[competition]\nname = "Autumn Cup"\n')
    settings = ["--settings", "madrob.toml"]
    assert main(["plan", "--plan", "plan.csv", *settings, *every]) == 0
    told = capsys.readouterr()
    assert "4 of 6 attempts done" in told.out
    assert "the same run as" in told.err
    assert main(["export", "--subject", "3", "--output", "team.zip", *every]) == 0
    assert "4 runs" in capsys.readouterr().out
    with zipfile.ZipFile("team.zip") as packed:
        names = {name.partition("/")[0] for name in packed.namelist() if "/" in name}
    assert len(names) == 4
    assert main(["standings", "--results", "a", "merged"]) == 2
    assert "give one of the two" in capsys.readouterr().err
