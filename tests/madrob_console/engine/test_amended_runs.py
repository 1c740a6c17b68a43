"""Void, correct, take back, doubts, protests: what they make of a run on disk; its dossier."""

from __future__ import annotations

import csv
import io
import json
import re
import shutil
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from madrob_console.archive.appeal import EQUAL
from madrob_console.archive.check import check_run
from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE, next_run_number
from madrob_console.archive.history import History
from madrob_console.archive.pictures import write_frames
from madrob_console.archive.repair import repair
from madrob_console.archive.run_journal import ever_protested, read_run_journal
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.scored import score_run
from madrob_console.archive.stored_runs import stored_run
from madrob_console.archive.table_columns import RUNS, rows_of
from madrob_console.cli.main import main
from madrob_console.common.errors import MadrobError
from madrob_console.engine.core import run_lines
from madrob_console.engine.playback import JumpTo, Skip
from madrob_console.engine.runtime.replay import Replay
from madrob_console.export.contents import dossier_contents
from madrob_console.export.papers import PROTESTS_FILE, README_FILE
from madrob_console.messages.types import MessageTypes
from madrob_console.pages.competition import CompetitionStandings, competition_standings
from madrob_console.pages.outputs import standings_details, standings_html
from madrob_console.pages.standings_files import standings_csv, standings_json
from madrob_console.pages.templates import render
from madrob_console.referee.acts import (
    ACT_CALLED,
    Act,
    AddNote,
    Correct,
    DecideProtest,
    FileProtest,
    Finalise,
    MarkIncident,
    Reissue,
    Rule,
    SetUp,
    Void,
)
from madrob_console.referee.acts.correct import last_decision
from madrob_console.referee.journal import Entry, read_journal
from madrob_console.referee.protests import ProtestEnd
from madrob_console.referee.records import IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from madrob_console.referee.run_summary import PROTEST_OPEN, RunSummary
from madrob_console.referee.team_list import TeamList
from madrob_console.testbeds.simulated import Scenario
from scoring.protocol import BenchmarkType, Condition, Side, Step
from tests.madrob_console.archive.frames import film
from tests.madrob_console.engine.drive import PULL, Deck, Drive, document, make_setup, signed
from tests.madrob_console.recorded_runs import completed, publish, recorded
from tests.recorder.samples import add_evidence, strings

CW = replace(PULL, starting_side=Side.CW)
"""Push, from CW: the recorded robot goes the other way."""
SIGNED = Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee")


class Desk(Drive):
    """A referee with an earlier run on the desk; a completed one if none is given."""

    def __init__(self, results: Path, source: Path | None = None) -> None:
        super().__init__(results)
        source = source or completed()
        self.results, self.run_folder = results, results / "practice" / source.name
        shutil.copytree(source, self.run_folder)
        assert self.open(self.run_folder) is None

    @property
    def document(self) -> dict[str, Any]:
        return document(self.run_folder)

    @property
    def lines(self) -> tuple[Entry, ...]:
        return read_journal(self.run_folder / JOURNAL_FILE)[0]

    @property
    def listed(self) -> RunSummary:
        (run,) = History(self.results).refresh()
        return run

    def agrees(self) -> bool:
        """Whether journal, result, recording and state say the same."""
        told = read_run_journal(self.run_folder).run
        run = self.engine.run
        told = replace(told, handle_zero=run.handle_zero, zero_samples=run.zero_samples)
        assert replace(told, journal=None) == run
        assert check_run(RunPath(self.run_folder)).differences == ()
        assert self.listed.problem is None
        return True


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path / "results")
    yield desk
    desk.engine.close()


def changed(before: dict[str, Any], after: dict[str, Any]) -> set[str]:
    """What differs between two results, but for the lines that they rest on."""
    return {key for key in before if before[key] != after[key]} - {"journal"}


def test_a_voided_run_keeps_its_indicators_and_counts_nowhere(desk: Desk) -> None:
    before = desk.document
    desk.act(Void("robot unsafe"))
    assert changed(before, desk.document) == {"voided", "flags"}
    run = desk.listed
    assert (run.valid, run.voided, run.outcome_word, run.reason) == (
        *(False, True, "VOID", "robot unsafe"),
    )
    desk.take_back()
    assert changed(before, desk.document) == {"taken_back"}
    assert [one["words"] for one in desk.document["taken_back"]] == ["void (robot unsafe)"]
    assert (desk.listed.valid, desk.agrees()) == (True, True)


def test_a_corrected_starting_side_is_scored_again_and_comes_back_to_the_last_digit(
    desk: Desk, tmp_path: Path
) -> None:
    before, names = desk.document, {path.name for path in desk.run_folder.iterdir()}
    desk.act(Correct(3, CW, "typed wrongly"))
    assert desk.agrees()
    after, listed = desk.document, desk.listed
    levels = [one["indicators"]["capability_level"]["value"] for one in (before, after)]
    assert (levels, after["condition_number"], after["run_number"]) == ([6, 3], 11, 1)
    assert after["setup"]["start_pose"] == {"x": -1.5, "y": 0.0, "yaw": 180.0}
    assert after["corrections"][0]["before"] == before["setup"]
    assert {"outcome", "stop", "start", "events"} & changed(before, after) == set()
    assert (listed.condition, listed.run_number, listed.folder) == (
        *(11, 1, f"practice/{desk.run_folder.name}"),
    )
    assert {path.name for path in desk.run_folder.iterdir()} == names
    assert desk.engine.snapshot().steps[3].done is False
    publish(desk.run_folder, tmp_path / "published")
    (scored,) = score_run(RunPath(tmp_path / "published", "subject_003_cond_001_run_001"), (None,))
    assert scored.result.condition == CW
    desk.take_back()
    assert (changed(before, desk.document), desk.agrees()) == ({"taken_back"}, True)
    words = "panel turned 1.037 rad against the opening side"
    desk.act(Correct(3, replace(PULL, opening_side=Side.CW), "typed wrongly"))
    for flags in (desk.engine.snapshot().flags, desk.listed.flags):
        assert words in [flag.words for flag in flags]


def test_a_corrected_subject_is_of_that_team_with_a_number_of_its_own(desk: Desk) -> None:
    desk.engine.set_teams(TeamList({3: "Delft", 4: "Graz"}))
    desk.act(Correct(4, PULL, "typed wrongly"))
    assert (desk.listed.subject, desk.listed.team, desk.listed.run_number) == (4, "Graz", 1)
    assert next_run_number(desk.results, 4, 1, practice=True) == 2
    assert next_run_number(desk.results, 3, 1, practice=True) == 2  # its own number stays its own
    assert desk.agrees()
    desk.take_back()
    assert (desk.listed.subject, desk.listed.team, desk.listed.run_number) == (3, "Delft", 1)
    desk.act(Correct(4, PULL, "right after all"))
    assert desk.listed.run_number == 2  # 1 was given out, and is nobody's
    assert desk.agrees()


def test_a_final_result_is_opened_again_and_its_issue_stays(desk: Desk) -> None:
    desk.act(SIGNED)
    signed = (desk.run_folder / "result.json").read_bytes()
    desk.act(Void("protest accepted"))
    assert (desk.run_folder / "result_issue_1.json").read_bytes() == signed
    assert (desk.document["issue"], desk.document["closure"]) == (2, None)
    desk.act(SIGNED)
    assert desk.agrees()
    desk.take_back()
    assert (desk.document["issue"], desk.document["voided"]) == (3, None)
    assert (desk.run_folder / "result_issue_2.json").exists()
    desk.act(SIGNED, Correct(4, PULL, "typed wrongly"))
    assert desk.document["issue"] == 4
    assert [
        (one["issue"], one["what"], one["reason"], one["referee"])
        for one in desk.document["reissues"]
    ] == [
        (2, "void", "protest accepted", "R. Eferee"),
        (3, "take back", "my mistake", "R. Eferee"),
        (4, "correct", "typed wrongly", "R. Eferee"),
    ]
    assert desk.agrees()


def test_the_report_tells_what_was_put_right(desk: Desk) -> None:
    desk.act(Correct(4, PULL, "typed wrongly"), Void("unsafe"), MarkIncident(IncidentKind.FALL))
    desk.take_back()
    text = re.sub("</?bdi>", "", render("decisions.html", run=desk.engine.run))
    assert "the run is void: unsafe" in text
    assert "corrected after the stop: subject from 3 to 4; typed wrongly" in text
    assert "fall</del> taken back: my mistake" in text


def test_a_replay_of_a_corrected_run_shows_the_decisions_of_then_and_today_s_result(
    desk: Desk,
) -> None:
    desk.act(Correct(3, CW, "typed wrongly"), Rule(Step.CROSS, confirmed=True, reason="seen"))
    desk.engine.close()
    deck, before = Deck(desk.run_folder), replace(make_setup(), practice=True)
    for _ in range(2):
        deck.do(JumpTo(5.0))
        assert deck.shown.run.setup == deck.shown.run.set_up_as == before
        shown = deck.to_the_end()
        assert shown.run.setup is not None
        assert (deck.at.comparison, shown.run.setup.condition) == (EQUAL, CW)
        assert shown.run.rulings != ()


conditions = st.builds(Condition, st.sampled_from(BenchmarkType), *[st.sampled_from(Side)] * 2)
acts = st.one_of(
    st.builds(Rule, st.sampled_from(Step), st.sampled_from([True, False, None]), st.just("seen")),
    st.builds(MarkIncident, st.sampled_from(IncidentKind)),
    st.just(Void("unsafe")),
    st.builds(Correct, st.integers(3, 4), conditions, st.just("typed wrongly")),
    st.just(FileProtest("we were earlier", "Delft")),
    st.builds(
        DecideProtest, st.integers(1, 2), st.sampled_from(ProtestEnd), st.just("seen"), st.just("A")
    ),
    st.just(SIGNED),
    st.just(Reissue("protest")),
    st.none(),
)


@given(st.lists(acts, min_size=1, max_size=8))
@settings(max_examples=8, deadline=None)
def test_whatever_is_decided_the_files_say_it_and_all_of_it_can_be_taken_back(
    sequence: Sequence[Act | None],
) -> None:
    """A result that does not know of it is made again; None takes the last decision back."""
    with TemporaryDirectory() as folder:
        desk = Desk(Path(folder), recorded(Scenario.TOUCH_ONLY))
        result, begun = desk.run_folder / RESULT_FILE, len(desk.lines)
        first, before = desk.document, result.read_bytes()
        done = 0
        for act in sequence:
            if act is not None:
                done += desk.engine.perform(act) is None
            elif last_decision(desk.engine.run) is not None:
                desk.take_back()
                done += 1
        assert done == sum(line.what in ACT_CALLED for line in desk.lines[begun:])
        assert desk.agrees()
        if desk.engine.run.phase is Phase.FINAL:
            desk.act(Reissue("back to the start"))
        while last_decision(desk.engine.run) is not None:
            desk.take_back()
        desk.engine.close()
        last = desk.document
        for key in ("indicators", "steps", "events", "setup", "rulings", "incidents", "voided"):
            assert last[key] == first[key]
        result.write_bytes(before)
        repair(desk.run_folder)  # by journal and recording
        assert desk.document == last


@pytest.mark.parametrize("limit", ["LARGEST_JOURNAL", "MOST_LINES"])
def test_a_full_journal_takes_what_ends_the_run_and_can_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str
) -> None:
    drive = Drive(tmp_path, Scenario.TOUCH_ONLY)
    drive.start(make_setup(timeout=4.0))
    monkeypatch.setattr(run_lines, limit, 2)
    full = "the journal of this run is full"
    assert full in str(drive.engine.perform(AddNote("a visitor")))
    drive.finish()
    assert full in str(drive.engine.perform(Void("the floor was wet")))
    folder = drive.folder
    drive.act(signed(drive.engine.snapshot()), SetUp(make_setup(run_number=2)))
    drive.engine.close()
    assert read_journal(folder / JOURNAL_FILE)[1] == ()
    (run,) = History(folder.parent).refresh()
    assert (run.problem, run.final) == (None, True)


CROSSED = FileProtest("we were through earlier", "Delft", "step 4: cross the threshold", 6.5)
UPHELD = DecideProtest(1, ProtestEnd.UPHELD, "seen on video", "R. Eferee")


@pytest.fixture(autouse=True)
def _own_settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


def found(desk: Desk) -> CompetitionStandings:
    return competition_standings(History(desk.results).refresh(), made=0.0, official=False)


def test_from_the_protest_over_the_replay_and_a_ruling_to_the_decision(desk: Desk) -> None:
    def not_final() -> bool:
        return "NOT FINAL: 1 PROTEST open" in "\n".join(standings_details(found(desk)))

    desk.act(SIGNED, CROSSED)
    run, stored = desk.listed, desk.document
    assert (run.closing, run.protested, run.final) == (PROTEST_OPEN, True, False)
    assert run.protest_at == pytest.approx(6.5)
    assert stored["issue"] == 2
    assert stored["protests"][0]["text"] == "we were through earlier"
    assert (desk.run_folder / "result_issue_1.json").exists()
    assert not_final()
    # the referee looks at the instant in question
    deck = Deck(desk.run_folder)
    deck.do(Skip(0.0), JumpTo(Replay(desk.run_folder, MessageTypes()).instant("protest")))
    deck.step(50)
    assert deck.at.position == pytest.approx(6.5, abs=0.02)
    assert deck.at.paused
    # what the decision changes, other acts do
    desk.act(Rule(Step.CROSS, confirmed=True, reason="seen on video"), UPHELD, SIGNED)
    desk.take_back()
    assert desk.listed.closing == PROTEST_OPEN
    desk.act(UPHELD, SIGNED)
    run = desk.listed
    assert (run.closing, run.protested, run.protest_filed) == ("final", True, None)
    words = "protest 1 (step 4: cross the threshold) upheld (seen on video)"
    assert words in [flag.words for flag in run.flags]
    assert desk.document["protests"][0]["answer"]["end"] == "upheld"
    assert (not_final(), desk.agrees()) == (False, True)


def test_while_a_protest_is_open_every_table_says_that_the_row_is_not_final(desk: Desk) -> None:
    desk.act(CROSSED)
    filed, standings = desk.engine.run.protests[0].time, found(desk)
    rows = csv.DictReader(io.StringIO(standings_csv(standings)))
    assert {row["open_protests"] for row in rows} == {"1"}
    told = json.loads(standings_json(standings, "1"))
    assert told["rulesets"][0]["overall"][0]["open_protests"] == 1
    assert told["open_protests"][0]["filed"] == filed
    page = standings_html(standings, "1")
    assert "NOT FINAL: 1 PROTEST open" in page
    assert "PROTEST open against run 1 of subject 3 in condition 1: NOT FINAL" in page
    (row,) = rows_of(RUNS, stored_run(RunPath(desk.run_folder)))
    assert (row["protests"], row["open_protests"], row["protest_filed"]) == (1, 1, filed)
    desk.act(Void("robot unsafe"))  # it counts nowhere, which the protest may be about
    assert "NOT FINAL: 1 PROTEST open" in "\n".join(standings_details(found(desk)))


def test_who_signed_under_protest_once_is_remembered_through_later_issues(desk: Desk) -> None:
    assert not desk.listed.protested
    assert not ever_protested(desk.run_folder)
    desk.act(replace(SIGNED, team_word=TeamWord.PROTESTED), Reissue("video"), SIGNED)
    assert desk.listed.closing == "final"
    assert desk.listed.protested
    assert ever_protested(desk.run_folder)
    journal = desk.run_folder / "journal.jsonl"
    journal.unlink()
    assert not ever_protested(desk.run_folder)
    journal.symlink_to(desk.run_folder / "result.json")  # nobody can read it
    assert ever_protested(desk.run_folder)


def test_the_instant_in_question_is_found_by_what_screens_and_files_call_it(
    desk: Desk, tmp_path: Path
) -> None:
    desk.act(SIGNED, CROSSED)
    replay = Replay(desk.run_folder, MessageTypes())
    named = "protest", "protest 1", "Protest 1", "protest_1", "PROTEST_1 ", "6.5", "0:06.5", "6.5 s"
    assert [replay.instant(one) for one in named] == pytest.approx([6.5] * len(named))
    events = {one["event"]: one["since_start"] for one in desk.document["events"]}
    assert replay.instant("door_opens") == pytest.approx(events["door_opens"])
    assert (replay.instant("start"), replay.instant("1:05.5")) == (0.0, 65.5)
    none = r"'protest 2' is no .* one of start, stop, .*protest_1"
    with pytest.raises(MadrobError, match=none):
        replay.instant("protest 2")
    film(desk.run_folder, "/camera/left")
    assert write_frames(desk.run_folder, "Protest 1", tmp_path / "frames") == []
    assert len(list((tmp_path / "frames").iterdir())) == 1
    (why,) = write_frames(desk.run_folder, "protest 2", tmp_path / "frames")
    assert re.search(none, why)


def test_an_event_without_a_time_is_none_of_a_replay(desk: Desk) -> None:
    journal = desk.run_folder / "journal.jsonl"
    lines = [json.loads(line) for line in journal.read_text().splitlines()]
    events = [line["details"] for line in lines if line["what"] == "event"]
    times: list[object] = [None, "soon", [1], {}, 10**400]
    for details, time in zip(events, times, strict=True):
        details["time"] = time
    journal.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    replay = Replay(desk.run_folder, MessageTypes())
    for details in events:
        with pytest.raises(MadrobError, match=f"'{details['event']}' is no time and no event"):
            replay.instant(details["event"])


# ---------------------------------------------------------------- the dossier


def dossier(desk: Desk, *options: str) -> dict[str, bytes]:
    """The files of the dossier by name."""
    name = f"practice/{desk.run_folder.name}"
    code = main(["export", "--run", name, "--dossier", "--results", str(desk.results), *options])
    assert code == 0
    with zipfile.ZipFile(dossier_contents(desk.run_folder).target) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name) for name in archive.namelist()}


def test_the_dossier_has_all_that_a_protest_is_decided_by(desk: Desk) -> None:
    desk.act(SIGNED, CROSSED, UPHELD, SIGNED)
    add_evidence(desk.run_folder, strings(["seen"]))
    files, name = dossier(desk), desk.run_folder.name
    report, readme = files[f"{name}/report.html"].decode(), files[README_FILE].decode()
    led = re.findall(r'<a href="([^"#]+)', report)
    inside = ("journal.jsonl", "result.json", "result_issue_1.json", "report.html", *led)
    tables = {f"tables/{name}_{table}.csv" for table in ("door", "handle", "passage")}
    assert {*(f"{name}/{part}" for part in inside), *tables} < {*files}
    for part in ("_evidence/", "_jointState.csv"):
        assert part in " ".join(files)
    for words in (b"Protest 1", b"UPHELD", b"we were through earlier", b", PRACTICE"):
        assert words in files[PROTESTS_FILE]
    assert (next(iter(files)), "UPHELD" in report, bool(led)) == (PROTESTS_FILE, True, True)
    assert readme.startswith(f"MADROB: dossier of the PRACTICE run {name}\n")
    assert f"  {PROTESTS_FILE}: the protests" in readme
    packed = dossier_contents(desk.run_folder).target
    assert packed.name == f"dossier_practice_{name}.zip"
    once = packed.read_bytes()
    assert once == (dossier(desk) and packed.read_bytes())  # the same run, the same bytes


def test_a_report_that_is_made_for_the_dossier_shows_what_the_cameras_saw(desk: Desk) -> None:
    film(desk.run_folder, "/camera/left")
    files = dossier(desk)
    report = files[f"{desk.run_folder.name}/report.html"].decode()
    assert '<img src="data:image/jpeg;base64,' in report
    assert not (desk.run_folder / "report.html").exists()
    without = dossier(desk, "--without-bags")
    readme = without[README_FILE].decode()
    assert "run 1: completed, not final, PRACTICE" in readme
    assert "the recordings were left out on demand" in readme
    assert not any(name.endswith(".mcap") for name in without)


def test_what_cannot_be_packed_is_named_and_the_rest_is_there(
    desk: Desk, capsys: pytest.CaptureFixture[str]
) -> None:
    desk.act(CROSSED)
    for bag in desk.run_folder.glob("*.mcap"):
        bag.write_bytes(b"no bag")
    run = str(desk.run_folder)
    assert main(["export", "--run", run, "--dossier", "--results", str(desk.results)]) == 2
    assert "tables of the samples: " in capsys.readouterr().err
    with zipfile.ZipFile(dossier_contents(desk.run_folder).target) as archive:
        assert "NOT IN THIS ARCHIVE" in archive.read(README_FILE).decode()
        assert PROTESTS_FILE in archive.namelist()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--run", "RUN"), "one run is packed as a dossier: give --run RUN with --dossier"),
        (("--dossier",), "give --run RUN with --dossier"),
        ((), "whose runs?"),
        (("--run", "RUN", "--dossier", "--subject", "3"), "leave out --subject"),
        (("--run", "/nowhere", "--dossier"), "no such run folder"),
        (("--run", "/tmp", "--dossier"), "is no run folder"),
    ],
)
def test_what_does_not_belong_together_is_refused_with_words(
    options: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", *options]) == 2
    assert words in capsys.readouterr().err
