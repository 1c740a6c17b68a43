"""Void, correct, take back and doubts: what they make of a run on disk, whoever reads it."""

from __future__ import annotations

import re
import shutil
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jsonschema
import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from madrob_console.archive.check import EQUAL, check_run
from madrob_console.archive.collection import collected_in
from madrob_console.archive.folders import JOURNAL_FILE, RunPath, next_run_number
from madrob_console.archive.history import History, RunSummary, earlier_runs
from madrob_console.archive.repair import repair
from madrob_console.archive.result_document import result_schema
from madrob_console.archive.run_journal import read_run_journal
from madrob_console.archive.scored import score_run
from madrob_console.common.errors import MadrobError
from madrob_console.engine import journal_writer
from madrob_console.engine.requests import JumpTo
from madrob_console.export.pack import README_FILE, BagParts
from madrob_console.export.team import export_team
from madrob_console.messages.codec import DEFAULT_MAPPINGS
from madrob_console.pages.competition import competition_standings
from madrob_console.pages.templates import render
from madrob_console.referee.acts import (
    Abort,
    AcceptDoubts,
    Act,
    AddNote,
    Correct,
    Finalise,
    MarkIncident,
    Reissue,
    Rule,
    SetUp,
    Start,
    TakeBack,
    Void,
    Waive,
    ZeroHandle,
)
from madrob_console.referee.acts.correct import last_decision
from madrob_console.referee.flags import undecided
from madrob_console.referee.journal import read_journal
from madrob_console.referee.lists import TeamList
from madrob_console.referee.records import CheckName, IncidentKind, TeamWord
from madrob_console.referee.run import Phase
from scoring.evaluate import Assessment
from scoring.indicator_table import IndicatorName
from scoring.kinematics import Rows
from scoring.procedure import Ruling
from scoring.protocol import BenchmarkType, Condition, Outcome, Side, Step
from scoring.result import Ending, Result, Uncertainty
from tests.madrob_console.engine.deck import Deck
from tests.madrob_console.engine.drive import PULL, Drive, make_setup, signed
from tests.madrob_console.recorded_runs import completed, publish

CW = replace(PULL, starting_side=Side.CW)
"""Push, from CW: the recorded robot goes the other way."""
SIGNED = Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee")


class Desk(Drive):
    """A referee with a completed run on the desk."""

    def __init__(self, results: Path) -> None:
        super().__init__(results)
        source = completed()
        self.results, self.run_folder = results, results / "practice" / source.name
        shutil.copytree(source, self.run_folder)
        assert self.open(self.run_folder) is None

    def take_back(self) -> None:
        last = last_decision(self.engine.run)
        assert last is not None
        self.act(TakeBack(last.kind, last.time, "my mistake"))

    @property
    def document(self) -> dict[str, Any]:
        found: dict[str, Any] = msgspec.json.decode((self.run_folder / "result.json").read_bytes())
        return found

    @property
    def indicators(self) -> dict[str, Any]:
        found: dict[str, Any] = self.document["indicators"]
        return found

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
        assert check_run(RunPath(self.run_folder)).found == ()
        assert self.listed.problem is None
        return True


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path)
    yield desk
    desk.engine.close()


def test_a_voided_run_keeps_its_indicators_and_counts_nowhere(desk: Desk) -> None:
    before = desk.indicators
    desk.act(Void("robot unsafe"))
    assert desk.indicators == before
    assert desk.document["voided"]["reason"] == "robot unsafe"
    assert desk.document["outcome"] == "completed"
    run = desk.listed
    assert (run.valid, run.voided, run.outcome_word, run.reason) == (
        *(False, True, "VOID", "robot unsafe"),
    )
    assert earlier_runs([run], 3, 1, run.started + 9, competition="", practice=run.practice) == ()
    found = competition_standings([run], made=0.0, official=False)
    assert [left.why for left in found.left_out] == ["robot unsafe"]
    (group,) = found.groups
    (team,) = group.overall
    assert (team.completed, team.voided, team.counted, team.aggregates) == (0, 1, 0, {})
    assert desk.agrees()
    desk.take_back()
    assert (desk.document["voided"], desk.listed.valid) == (None, True)
    assert [one["words"] for one in desk.document["taken_back"]] == ["void (robot unsafe)"]
    assert desk.agrees()


def test_a_corrected_starting_side_is_scored_again_and_comes_back_to_the_last_digit(
    desk: Desk,
) -> None:
    before, names = desk.document, sorted(path.name for path in desk.run_folder.iterdir())
    assert before["indicators"]["capability_level"]["value"] == 6
    desk.act(Correct(3, CW, "typed wrongly"))
    assert desk.agrees()
    after = desk.document
    assert after["indicators"]["capability_level"]["value"] == 3
    assert after["setup"]["start_pose"] == {"x": -1.5, "y": 0.0, "yaw": 180.0}
    assert (after["condition_number"], after["run_number"]) == (11, 1)
    assert after["outcome"], after["stop"] == (before["outcome"], before["stop"])
    assert after["corrections"][0]["before"] == before["setup"]
    assert (desk.listed.condition, desk.listed.run_number) == (11, 1)
    assert desk.listed.folder == f"practice/{desk.run_folder.name}"
    assert sorted(path.name for path in desk.run_folder.iterdir()) == names
    assert desk.engine.snapshot().steps[3].done is False
    desk.take_back()
    assert desk.agrees()
    assert desk.document["indicators"] == before["indicators"]
    assert desk.document["setup"] == before["setup"]
    assert desk.engine.snapshot().steps[3].done


def test_what_another_opening_side_made_of_the_data_is_not_said_any_more(desk: Desk) -> None:
    desk.act(Correct(3, replace(PULL, opening_side=Side.CW), "typed wrongly"))
    assert any("against the opening side" in r for r in desk.document["quality"]["remarks"])
    words = "panel turned 1.037 rad to the CCW side, against the opening side"
    assert words in [flag.words for flag in desk.engine.snapshot().flags]
    assert words in [flag.words for flag in desk.listed.flags]
    assert desk.agrees()
    desk.take_back()
    assert words not in [flag.words for flag in desk.listed.flags]
    assert not any("against the opening side" in r for r in desk.document["quality"]["remarks"])
    assert desk.agrees()


def test_a_corrected_subject_is_of_that_team_with_a_number_of_its_own(desk: Desk) -> None:
    desk.engine.hear_of_teams(TeamList({3: "Delft", 4: "Graz"}))
    desk.act(Correct(4, PULL, "typed wrongly"))
    assert (desk.listed.subject, desk.listed.team, desk.listed.run_number) == (4, "Graz", 1)
    assert next_run_number(desk.results, 4, 1, practice=True) == 2
    assert next_run_number(desk.results, 3, 1, practice=True) == 2  # its own number stays its own
    assert desk.agrees()
    (scored,) = score_run(RunPath(desk.run_folder), (None,))
    assert scored.condition == PULL
    desk.take_back()
    assert (desk.listed.subject, desk.listed.team, desk.listed.run_number) == (3, "Delft", 1)
    desk.act(Correct(4, PULL, "right after all"))
    assert desk.listed.run_number == 2  # 1 was given out, and is nobody's
    assert desk.agrees()


def test_a_corrected_run_never_gets_the_number_of_another(desk: Desk) -> None:
    desk.whole_run(replace(make_setup(), subject=4, team="Graz"))
    assert desk.open(desk.run_folder) is None
    desk.act(Correct(4, PULL, "typed wrongly"))
    runs = History(desk.results).refresh()
    assert [(run.subject, run.condition, run.run_number) for run in runs] == [(4, 1, 2), (4, 1, 1)]
    assert desk.engine.perform(SetUp(replace(make_setup(run_number=2), subject=4))) is None


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


def test_a_run_is_voided_in_the_moment_of_its_stop(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.start(make_setup())
    drive.wait_until(lambda: drive.engine.run.phase is Phase.STOPPED)
    drive.act(Void("robot unsafe"))
    drive.finish()
    drive.engine.close()
    (run,) = History(tmp_path).refresh()
    assert (run.voided, run.issue) == (True, 1)
    assert check_run(RunPath(drive.folder)).found == ()


def test_a_result_that_does_not_know_of_a_correction_is_made_again(desk: Desk) -> None:
    before = (desk.run_folder / "result.json").read_bytes()
    desk.act(Correct(3, CW, "typed wrongly"), Void("unsafe"))
    desk.engine.close()
    right = desk.document
    (desk.run_folder / "result.json").write_bytes(before)
    assert desk.listed.repairable
    assert repair(desk.run_folder) is not None
    assert desk.document == right
    assert desk.listed.voided


def test_what_was_taken_back_is_not_kept_from_a_result_that_does_not_know_it(
    tmp_path: Path,
) -> None:
    drive = Drive(tmp_path)
    drive.act(SetUp(make_setup()))
    drive.wait(1.5)
    drive.act(ZeroHandle(), Waive(CheckName.POSE, "seen on video"), Start())
    drive.finish()
    folder, last = drive.engine.folder, last_decision(drive.engine.run)
    assert folder is not None
    assert last is not None
    before = (folder / "result.json").read_bytes()
    assert b"check waived: start pose" in before
    drive.act(TakeBack(last.kind, last.time, "it was confirmed"))
    drive.engine.close()
    (folder / "result.json").write_bytes(before)
    assert repair(folder) is not None
    assert msgspec.json.decode((folder / "result.json").read_bytes())["quality"]["remarks"] == []
    assert check_run(RunPath(folder)).found == ()


def test_a_corrected_run_is_packed_for_its_team(desk: Desk) -> None:
    desk.act(Correct(4, PULL, "typed wrongly"), Void("protest accepted"))
    desk.engine.close()
    made = export_team(
        collected_in(desk.results),
        4,
        DEFAULT_MAPPINGS,
        0.0,
        parts=BagParts(recording=False),
        practice=True,
    )
    with zipfile.ZipFile(made.path) as packed:
        text = " ".join(packed.read(README_FILE).decode().split())
    assert f"{desk.run_folder.name}" in text
    assert "run 1: completed, VOID (protest accepted), not final" in text
    with pytest.raises(MadrobError, match="there are runs of subject 4"):
        export_team(collected_in(desk.results), 3, DEFAULT_MAPPINGS, 0.0, practice=True)


def test_the_report_tells_what_was_put_right(desk: Desk) -> None:
    desk.act(Correct(4, PULL, "typed wrongly"), Void("unsafe"), MarkIncident(IncidentKind.FALL))
    desk.take_back()
    text = re.sub("</?bdi>", "", render("decisions.html", run=desk.engine.run))
    assert "the run is void: unsafe" in text
    assert "corrected after the stop: subject from 3 to 4; typed wrongly" in text
    assert "fall</del> taken back: my mistake" in text


def test_a_replay_of_a_corrected_run_shows_what_was_decided_then_and_the_result_of_now(
    desk: Desk,
) -> None:
    desk.act(Correct(3, CW, "typed wrongly"), Rule(Step.CROSS, confirmed=True, reason="seen"))
    desk.engine.close()
    deck = Deck(desk.run_folder)
    deck.do(JumpTo(5.0))
    before = replace(make_setup(), practice=True)
    assert deck.shown.run.setup == deck.shown.run.set_up_as == before
    shown = deck.to_the_end()
    assert deck.at.comparison == EQUAL
    assert shown.run.setup is not None
    assert shown.run.setup.condition == CW
    assert shown.run.rulings != ()
    deck.do(JumpTo(5.0))
    assert deck.shown.run.setup == before
    deck.engine.close()


def test_the_published_files_of_a_corrected_run_say_what_it_is(desk: Desk, tmp_path: Path) -> None:
    desk.act(Correct(3, CW, "typed wrongly"))
    publish(desk.run_folder, tmp_path / "published")
    (scored,) = score_run(RunPath(tmp_path / "published", "subject_003_cond_001_run_001"), (None,))
    assert scored.condition == CW


conditions = st.builds(Condition, st.sampled_from(BenchmarkType), *[st.sampled_from(Side)] * 2)
acts = st.one_of(
    st.builds(Rule, st.sampled_from(Step), st.sampled_from([True, False, None]), st.just("seen")),
    st.builds(MarkIncident, st.sampled_from(IncidentKind)),
    st.just(Void("unsafe")),
    st.builds(Correct, st.integers(3, 4), conditions, st.just("typed wrongly")),
    st.just(SIGNED),
    st.just(Reissue("protest")),
    st.none(),
)


@given(st.lists(acts, min_size=1, max_size=8))
@settings(max_examples=12, deadline=None)
def test_whatever_is_decided_the_files_say_it_and_all_of_it_can_be_taken_back(
    sequence: Sequence[Act | None],
) -> None:
    with TemporaryDirectory() as folder:
        desk = Desk(Path(folder))
        first = desk.document
        for act in sequence:
            last = last_decision(desk.engine.run)
            if act is not None:
                desk.engine.perform(act)
            elif last is not None:
                desk.engine.perform(TakeBack(last.kind, last.time, "my mistake"))
        assert desk.agrees()
        if desk.engine.run.phase is Phase.FINAL:
            desk.act(Reissue("back to the start"))
        while last_decision(desk.engine.run) is not None:
            desk.take_back()
        assert desk.agrees()
        for key in ("indicators", "steps", "events", "setup", "rulings", "incidents", "voided"):
            assert desk.document[key] == first[key]
        desk.engine.close()
        lines = (desk.run_folder / JOURNAL_FILE).read_text().splitlines()
        assert len(lines) >= len(sequence)


LONG = "x" * 2001


@pytest.fixture
def running(tmp_path: Path) -> Drive:
    drive = Drive(tmp_path)
    drive.start(make_setup())
    return drive


def refused(drive: Drive, act: Act) -> str:
    return drive.engine.perform(act) or ""


def test_a_text_that_is_too_long_is_refused_and_the_longest_is_not(running: Drive) -> None:
    assert "at most 2000 characters" in refused(running, AddNote(LONG))
    assert refused(running, AddNote(LONG[:-1])) == ""
    assert [note.text for note in running.engine.run.notes] == [LONG[:-1]]
    running.engine.close()


def test_no_field_of_a_setup_is_longer(drive: Drive) -> None:
    setup = replace(make_setup(), team_reason=LONG)
    assert "at most 2000 characters" in refused(drive, SetUp(setup))


def test_an_abort_with_a_long_reason_is_done_and_its_reason_cut(running: Drive) -> None:
    assert refused(running, Abort(LONG)) == ""
    assert running.engine.run.outcome is Outcome.ABORTED
    assert running.engine.run.outcome_reason == LONG[:-1]
    running.engine.close()


@pytest.mark.parametrize("limit", ["LARGEST_JOURNAL", "MOST_LINES"])
def test_a_full_journal_takes_what_ends_the_run_and_can_be_read(
    running: Drive, monkeypatch: pytest.MonkeyPatch, limit: str
) -> None:
    monkeypatch.setattr(journal_writer, limit, 2)
    assert "the journal of this run is full" in refused(running, AddNote("a visitor"))
    running.finish()
    assert "the journal of this run is full" in refused(running, Void("the floor was wet"))
    folder = running.engine.folder
    assert folder is not None
    running.act(signed(running.engine.snapshot()))
    assert running.engine.run.phase is Phase.FINAL
    running.act(SetUp(make_setup(run_number=2)))
    running.engine.close()
    assert read_journal(folder / JOURNAL_FILE)[1] == ()
    (run,) = History(folder.parent).refresh()
    assert (run.problem, run.final) == (None, True)


TOUCH = "the touch rests on 1 sample"
JITTER = "the stamps jitter by 2.1 ms"
TIME = IndicatorName.TIME_TO_HANDLE
ACCEPTED = AcceptDoubts({TIME: (TOUCH,)}, "seen on video: right")
WAITS = ["doubted: time to handle (1 doubt UNDECIDED)"]


@pytest.fixture
def doubted_desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    """A run whose touch is doubted; where it does not come to its end, for another reason, too."""
    completed()  # others use it, too, as it was made
    plain = Assessment.result

    def doubted(
        self: Assessment,
        ending: Ending,
        rulings: Sequence[Ruling] = (),
        remarks: Iterable[str] = (),
    ) -> tuple[Result, Rows]:
        result, rows = plain(self, ending, rulings, remarks)
        found = {
            name: replace(one, uncertainty=None, doubts=())
            for name, one in result.indicators.items()
        }
        whole = found[IndicatorName.CAPABILITY_LEVEL].value == 6
        doubts = (TOUCH,) if whole else (TOUCH, JITTER)
        found[TIME] = replace(found[TIME], uncertainty=Uncertainty(0.01, 0.02), doubts=doubts)
        return replace(result, indicators=found), rows

    monkeypatch.setattr(Assessment, "result", doubted)
    doubted_desk = Desk(tmp_path)
    yield doubted_desk
    doubted_desk.engine.close()


def waiting(doubted_desk: Desk) -> list[str]:
    """What the screens say that is undecided, and the same of the history."""
    found = [flag.words for flag in undecided(doubted_desk.engine.snapshot().flags)]
    assert [flag.words for flag in undecided(doubted_desk.listed.flags)] == found
    return found


def test_an_accepted_doubt_stands_in_the_result_beside_the_doubt(doubted_desk: Desk) -> None:
    doubted_desk.act(ACCEPTED)
    document = doubted_desk.document
    jsonschema.validate(document, result_schema())
    (answer,) = document["accepted_doubts"]
    assert answer["doubts"] == {"time_to_handle": [TOUCH]}
    assert (answer["reason"], answer["referee"]) == ("seen on video: right", "R. Eferee")
    assert document["indicators"]["time_to_handle"]["doubts"] == [TOUCH]
    assert document["indicators"]["time_to_handle"]["uncertainty"] == {"u": 0.01, "expanded": 0.02}
    assert (doubted_desk.listed.doubts, doubted_desk.listed.uncertainties) == (
        *({TIME: 1}, {TIME: Uncertainty(0.01, 0.02)}),
    )
    assert (
        doubted_desk.listed.sign(TIME),
        doubted_desk.listed.sign(IndicatorName.PASSAGE_TIME),
    ) == ("?", "")
    assert waiting(doubted_desk) == []
    assert doubted_desk.agrees()


def test_what_a_correction_makes_doubtful_waits_though_the_rest_was_accepted(
    doubted_desk: Desk,
) -> None:
    doubted_desk.act(ACCEPTED, Correct(3, CW, "typed wrongly"))
    assert doubted_desk.document["indicators"]["time_to_handle"]["doubts"] == [TOUCH, JITTER]
    assert waiting(doubted_desk) == WAITS
    doubted_desk.act(AcceptDoubts({TIME: (JITTER,)}, "no effect on the ranking"))
    assert waiting(doubted_desk) == []
    assert doubted_desk.agrees()
