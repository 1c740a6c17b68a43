"""Runs of any number of results folders and testbeds, at any depth, each once."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import UUID

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.archive.check import Grade, check_run
from madrob_console.archive.collection import collected, collected_in, filter_problem, matches
from madrob_console.archive.history import History
from madrob_console.archive.run_paths import RunPath, all_runs_at, runs_at
from madrob_console.archive.run_record import RECORD_NAME
from madrob_console.cli.output import BAD_INPUT
from madrob_console.common.errors import MadrobError
from madrob_console.pages.competition import competition_standings, how_testbeds_differ
from madrob_console.referee.acts import Correct, SetUp
from madrob_console.referee.run_summary import RunSummary
from recorder.reader import Bag
from scoring.protocol import Outcome
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.engine.drive import PULL, Drive, make_setup
from tests.madrob_console.recorded_runs import completed
from tests.madrob_console.run_folders import summary, write

HALLS = {"Hall A": "a", "Hall B": "merged/halls/b"}
SAME_NAME = "subject_003_cond_007_run_001"


def run_id(hall: str, number: int) -> str:
    return f"018b{ord(hall[-1]):04x}-0000-7000-8000-{number:012d}"


@pytest.fixture
def halls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two testbeds with two runs each; the folders of one are called like those of the other."""
    monkeypatch.chdir(tmp_path)
    for hall, place in HALLS.items():
        for number in (1, 2):
            told: dict[str, Any] = {"testbed": hall, "run_id": run_id(hall, number), "rate": 50.0}
            write(Path(place), summary(3, run_number=number, hour=number, **told))
    return tmp_path


def test_runs_lie_at_any_depth_and_two_testbeds_may_have_one_folder_name(
    halls: Path,
) -> None:
    found = collected([Path("merged"), Path("a"), Path("merged/halls")])
    expected = [("Hall A", 1), ("Hall B", 1), ("Hall A", 2), ("Hall B", 2)]
    assert [(run.testbed, run.run_number) for run in found.runs] == expected
    assert all((found.root / run.folder / "result.json").exists() for run in found.runs)
    assert not [*found.twins, *found.unlisted]
    ((team,),) = (made.overall for made in competition_standings(found.runs, made=0.0).groups)
    assert (team.completed, team.testbeds) == (4, ("Hall A", "Hall B"))
    places = [run.path.parent for run in all_runs_at([Path("merged"), Path("a"), Path("merged")])]
    assert places == [Path("merged/halls/b")] * 2 + [Path("a")] * 2
    (halls / "a" / "around").symlink_to("..")
    shutil.copytree("merged", "a/.kept/merged")
    assert [run.path.parent for run in runs_at(Path("a"))] == [Path("a")] * 2


def test_the_same_run_met_twice_counts_once_and_both_places_are_named(halls: Path) -> None:
    first = next(Path("a").glob(f"{SAME_NAME}*"))
    again = Path("copies") / first.name.replace("_22", "_21").replace("_23", "_22")
    shutil.copytree(first, again)
    for paths in ([Path("a"), Path("copies")], [Path("copies"), Path("a")]):
        found = collected(paths)
        (remark,) = found.twins
        assert (str(first) in remark, str(again) in remark) == (True, True)
        (made,) = competition_standings(found.runs, made=0.0).groups
        assert made.overall[0].completed == 2
    shutil.copytree(first, Path("a") / again.name)  # in the results folder itself
    found = collected_in(Path("a"))
    assert [run.outcome_word for run in found.runs].count("TWICE") == 1
    (why,) = (left.why_left_out for left in competition_standings(found.runs, made=0.0).left_out)
    assert (first.name in why, again.name in why) == (True, True)


def test_of_a_run_that_is_there_twice_the_latest_issue_counts(halls: Path) -> None:
    told: dict[str, Any] = {"testbed": "Hall A", "run_id": run_id("Hall A", 1), "issue": 2}
    write(Path("later"), summary(3, run_number=1, hour=1, **told))
    for paths in (["a", "later"], ["later", "a"]):
        (twin,) = (run for run in collected(list(map(Path, paths))).runs if run.twin)
        assert (twin.issue, Path(twin.twin).parent) == (1, Path("later"))


def test_one_testbed_can_be_asked_for(halls: Path, madrob: Madrob) -> None:
    with pytest.raises(MadrobError, match=r"'Hall C'.*there are 'Hall A', 'Hall B'"):
        collected([halls], "Hall C")
    rows = madrob("standings a merged --testbed-name 'Hall B' --csv").splitlines()
    assert rows[1].split(",")[8:11] == ["Hall B", "Autumn Cup", "2"]


COMMANDS = (
    "standings",
    "plan --plan plan.csv",
    "export --subject 3 --output team.zip",
)


def test_what_is_in_no_list_is_named_with_what_to_do_and_the_rest_is_there(
    halls: Path, madrob: Madrob
) -> None:
    with pytest.raises(MadrobError, match="no such folder"):
        collected([Path("none")])
    run = next(Path("a").glob(f"{SAME_NAME}*"))
    for folder in ("final", "bag", "locked", "empty", "linked"):
        Path(folder).mkdir()
    shutil.copy(run / "result.json", "final")
    for recording in (Path("final") / f"{run.name}_0.mcap", Path("bag/b_0.mcap"), Path("b.mcap")):
        recording.touch()
    Path("locked").chmod(0)
    Path("linked", run.name).symlink_to(run.absolute())
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
        del expected["locked"]
    damaged = next(Path("a").glob("*_run_002_*"))
    (damaged / "result.json").write_text("{")
    for command in COMMANDS:
        said = madrob.say(command, *expected, "a")
        lines = sorted(line for line in said.err.splitlines() if damaged.name not in line)
        assert lines == sorted(f"madrob: {place}: {why}" for place, why in expected.items())
        assert f"{damaged.name}: result.json is damaged" in said.err
        assert (said.code, said.out != "") == (BAD_INPUT, True)
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
    assert (run.practice, run.subject, run.problem) == (True, 4, None)


def test_testbeds_that_differ_say_so_in_one_line() -> None:
    def differ(*runs: dict[str, Any]) -> str:
        numbers = (1, 2)
        return how_testbeds_differ([summary(3, run_number=n, **of) for of in runs for n in numbers])

    hall: dict[str, Any] = {"testbed": "A", "rate": 50.0, "thresholds": {}}
    near = hall | {"testbed": "B", "rate": 50.02}
    other = near | {"rate": 100.0, "thresholds": {"touch_force": 3.0}, "ruleset": "robust-2026"}
    assert (differ(hall | {"rate": 49.98}, near), differ(hall)) == ("", "")
    assert differ(hall, other) == (
        "The testbeds differ: ruleset protocol (A), robust-2026 (B); sampling rate 50 Hz (A), "
        "100 Hz (B); touch_force 1.96133 (A), 3 (B)."
    )
    assert "thresholds" not in differ(hall | {"thresholds": None}, other)


@pytest.mark.parametrize(
    ("command", "code", "told"),
    [
        ("standings --details", 0, ["3 Team 3: 4 completed; on Hall A, Hall B", "TWICE: "]),
        (
            f"{COMMANDS[1]} --settings cup.toml",
            *(0, ["4 of 6 attempts done", "the same run as"]),
        ),
        (
            COMMANDS[2],
            *(2, ["2 runs", "another run has this name: export its results folder alone"]),
        ),
        ("standings --results a", 2, ["give one of the two"]),
    ],
)
def test_standings_plan_and_export_take_several_folders(
    command: str, code: int, told: list[str], halls: Path, madrob: Madrob
) -> None:
    run = next(Path("a").glob(f"{SAME_NAME}*"))
    shutil.copytree(run, Path("b") / f"{SAME_NAME}_20200101_000000")
    Path("plan.csv").write_text("3,7,6\n")
    Path("cup.toml").write_text('[competition]\nname = "Autumn Cup"\n')
    said = madrob.say(f"{command} a merged b")
    assert said.code == code
    assert [words for words in told if words not in said.out + said.err] == []


FIELDS = "subject, sub, cond, run, team, outcome, closed, ruleset, testbed, competition"
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=60)
RUNS = st.builds(
    summary,
    subject=st.integers(1, 999),
    condition=st.integers(1, 20),
    team=TEXTS,
    outcome=st.sampled_from(Outcome),
    competition=TEXTS,
)
RUN = summary(3, 12, 2, team="TU Delft 門", final=True, team_word="protested", source="simulated")


FOUND = [
    "", "  ", "delft", "DELFT tu", "門", "push", "from cw to ccw", "constant", "completed",
    "simulated", "protested", "autumn", "2023-11", "subject:3", "subject:003", "SUBJECT:3",
    "run:2", "cond:12", "sub:3", "outcome:completed", "team:delft", "team:門",
    "subject:3 run:2 delft", "subject:", "team:", ":",
]  # fmt: skip
NOT_FOUND = [
    "ghent", "delft ghent", "pull", "timeout", "subject:2", "subject:33", "subject:x",
    "subject:0", "run:3", "run:12", "cond:1", "cond:2", "team:push", "team:simulated", "14:28",
    "team:a:b",
]  # fmt: skip
UNKNOWN = {
    "foo:bar": "foo",
    "delft foo:": "foo",
    "FOO:bar": "foo",
    "ÉQUIPE:1": "équipe",
    "x:y": "x",
}


@pytest.mark.parametrize("text", [*FOUND, *NOT_FOUND, *UNKNOWN])
def test_a_filter_finds_a_run_by_its_words_and_names_a_field_that_no_run_has(text: str) -> None:
    assert matches(RUN, text) == (text in FOUND)
    problem = f"no field {UNKNOWN.get(text)}: there are {FIELDS}"
    assert filter_problem(text) == (problem if text in UNKNOWN else None)


@given(RUNS, TEXTS, TEXTS)
def test_more_words_never_find_more(run: RunSummary, first: str, second: str) -> None:
    both = matches(run, f"{first} {second}")
    assert both == (matches(run, first) and matches(run, second))


def stored(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "result.json").read_text())
    return content


def test_identity_and_testbed_stand_in_journal_recording_result_and_run_info() -> None:
    run, result = completed(), stored(completed())
    told = {"run_id": result["run_id"], "testbed": "Hall A"}
    assert UUID(told["run_id"]).version == 7
    first = json.loads((run / "journal.jsonl").read_text().partition("\n")[0])
    recorded = json.loads(Bag(run).records[RECORD_NAME]["run"])
    info = yaml.safe_load(next(run.glob("run_info_*.yaml")).read_text())
    setups = (result["setup"], first["details"]["setup"], recorded["setup"], info["settings"])
    assert all(content.items() >= told.items() for content in (result, *setups))
    (listed,) = History(run.parent.parent).refresh()
    assert {"run_id": listed.run_id, "testbed": listed.testbed} == told
    assert (matches(listed, "testbed:hall"), matches(listed, "testbed:b")) == (True, False)


def test_each_set_up_has_an_identity_of_its_own_whatever_a_screen_sends(drive: Drive) -> None:
    sent, found = make_setup(), set[str]()
    for _ in range(4):  # as new, and as the screen has got it
        drive.act(SetUp(sent))
        setup = drive.engine.run.setup
        assert setup is not None
        assert setup == replace(make_setup(), practice=True)
        found.add(setup.run_id)
        sent = setup if len(found) % 2 else make_setup()
    assert len(found) == 4


def test_a_corrected_run_is_still_the_same_run(tmp_path: Path) -> None:
    before = stored(completed())
    folder = shutil.copytree(completed(), tmp_path / "practice" / completed().name)
    drive = Drive(tmp_path)
    assert drive.open(folder) is None
    drive.act(Correct(5, PULL, "the wrong team", "Ghent"))
    drive.wait(1.0)
    drive.engine.close()
    assert (stored(folder)["subject"], stored(folder)["run_id"]) == (5, before["run_id"])
    assert check_run(RunPath(folder)).grade is Grade.SAME
