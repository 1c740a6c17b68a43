"""A protest from its filing to its decision: what everybody reads of it meanwhile and later."""

from __future__ import annotations

import csv
import io
import json
import re
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from madrob_console.archive.history import History
from madrob_console.archive.run_journal import ever_protested
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.run_pictures import write_frames
from madrob_console.archive.stored_runs import stored_run
from madrob_console.archive.table_columns import RUNS, rows_of
from madrob_console.cli.main import main
from madrob_console.common.errors import MadrobError
from madrob_console.engine.playback import JumpTo, Skip
from madrob_console.engine.runtime.replay import Replay
from madrob_console.export.contents import dossier_contents
from madrob_console.export.papers import PROTESTS_FILE, README_FILE
from madrob_console.messages.message_types import MessageTypes
from madrob_console.pages.competition import CompetitionStandings, competition_standings
from madrob_console.pages.outputs import standings_details, standings_html
from madrob_console.pages.standings_files import standings_csv, standings_json
from madrob_console.referee.acts import (
    DecideProtest,
    FileProtest,
    Finalise,
    Reissue,
    Rule,
    Void,
)
from madrob_console.referee.protests import ProtestEnd
from madrob_console.referee.records import TeamWord
from madrob_console.referee.run_summary import PROTEST_OPEN
from scoring.protocol import Step
from tests.madrob_console.archive.frames import film
from tests.madrob_console.engine.drive import Deck
from tests.madrob_console.engine.test_amended_runs import Desk
from tests.recorder.samples import add_evidence, strings

CROSSED = FileProtest("we were through earlier", "Delft", "step 4: cross the threshold", 6.5)
UPHELD = DecideProtest(1, ProtestEnd.UPHELD, "seen on video", "R. Eferee")
SIGNED = Finalise(TeamWord.ACKNOWLEDGED, "R. Eferee")


@pytest.fixture(autouse=True)
def _own_settings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path / "results")
    yield desk
    desk.engine.close()


def found(desk: Desk) -> CompetitionStandings:
    return competition_standings(History(desk.results).refresh(), made=0.0, official=False)


def test_from_the_protest_over_the_replay_and_a_ruling_to_the_decision(desk: Desk) -> None:
    def not_final() -> bool:
        return "NOT FINAL: 1 PROTEST open" in "\n".join(standings_details(found(desk)))

    desk.act(SIGNED, CROSSED)
    run, stored = desk.listed, desk.document
    assert (run.closing, run.protested, run.final) == (PROTEST_OPEN, True, False)
    assert (run.protest_at, stored["issue"]) == (pytest.approx(6.5), 2)
    assert stored["protests"][0]["text"] == "we were through earlier"
    assert (desk.run_folder / "result_issue_1.json").exists()
    assert not_final()
    # the referee looks at the instant in question
    deck = Deck(desk.run_folder)
    deck.do(Skip(0.0), JumpTo(Replay(desk.run_folder, MessageTypes()).instant("protest")))
    deck.step(50)
    assert (deck.at.position, deck.at.paused) == (pytest.approx(6.5, abs=0.02), True)
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
    pictures = desk.run_folder / "pictures"
    pictures.mkdir()
    (pictures / "door_opens.jpg").write_bytes(b"a picture")
    add_evidence(desk.run_folder, strings(["seen"]))
    files, name = dossier(desk), desk.run_folder.name
    report, readme = files[f"{name}/report.html"].decode(), files[README_FILE].decode()
    led = re.findall(r'<a href="([^"#]+)', report)
    inside = ("journal.jsonl", "result.json", "result_issue_1.json", "report.html", *led)
    tables = {f"tables/{name}_{table}.csv" for table in ("door", "handle", "passage")}
    assert {*(f"{name}/{part}" for part in inside), *tables} < {*files}
    assert files[f"{name}/pictures/door_opens.jpg"] == b"a picture"
    for part in ("_evidence_", "_jointState.csv"):
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
    assert re.search(r'href="pictures/[^"]+[.]jpg"', report)
    layout = json.loads(files["madrob_foxglove_layout.json"])
    (panel,) = (one for one in layout["configById"].values() if "imageMode" in one)
    assert panel["imageMode"] == {"imageTopic": "/camera/left"}
    assert not any((desk.run_folder / made).exists() for made in ("pictures", "report.html"))
    without = dossier(desk, "--without-bags")
    readme = without[README_FILE].decode()
    assert "run 1: completed, not final, PRACTICE" in readme
    assert "the recording was left out on demand" in readme
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
