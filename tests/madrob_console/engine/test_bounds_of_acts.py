"""A text has a limit, and so has a journal; what ends a run is refused by neither."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from madrob_console.archive.folders import JOURNAL_FILE
from madrob_console.archive.history import History
from madrob_console.engine.live import journal_keeper
from madrob_console.referee.acts import Abort, Act, AddNote, SetUp, Void
from madrob_console.referee.journal import read_journal
from madrob_console.referee.run import Phase
from scoring.protocol import Outcome
from tests.madrob_console.engine.drive import Drive, make_setup, signed

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


def test_no_field_of_a_setup_is_longer(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    setup = replace(make_setup(), team_reason=LONG)
    assert "at most 2000 characters" in refused(drive, SetUp(setup))
    drive.engine.close()


def test_an_abort_with_a_long_reason_is_done_and_its_reason_cut(running: Drive) -> None:
    assert refused(running, Abort(LONG)) == ""
    assert running.engine.run.outcome is Outcome.ABORTED
    assert running.engine.run.outcome_reason == LONG[:-1]
    running.engine.close()


@pytest.mark.parametrize("limit", ["LARGEST_JOURNAL", "MOST_LINES"])
def test_a_full_journal_takes_what_ends_the_run_and_can_be_read(
    running: Drive, monkeypatch: pytest.MonkeyPatch, limit: str
) -> None:
    monkeypatch.setattr(journal_keeper, limit, 2)
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
