"""The journal: on disk before it takes effect, readable whatever happened to its end."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.errors import MadrobError
from madrob_console.referee.acts import Abort, Rule, SetUp, act_details
from madrob_console.referee.journal import Entry, Journal, Origin, read_journal
from madrob_console.referee.rebuild import Change, act_of, rebuild
from madrob_console.referee.run import Phase
from scoring.protocol import Outcome, Step
from tests.madrob_console.referee.test_acts import SETUP

texts = st.text(max_size=40)
entries = st.builds(
    Entry,
    st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from(Origin),
    texts,
    texts,
    texts,
    st.dictionaries(texts, st.one_of(texts, st.integers(), st.booleans()), max_size=3),
)


@given(entries)
def test_a_line_comes_back_as_it_was(entry: Entry) -> None:
    line = entry.to_json()
    assert "\n" not in line
    assert Entry.from_json(line) == entry


@given(st.text())
def test_what_is_no_line_raises_nothing_but_our_error(text: str) -> None:
    with suppress(MadrobError):
        Entry.from_json(text)


def line(number: int) -> Entry:
    return Entry(float(number), Origin.SYSTEM, f"line {number}")


def test_lines_from_before_the_file_come_first(tmp_path: Path) -> None:
    journal = Journal()
    assert journal.append(line(0), must_take_effect=False) is None
    journal.open(tmp_path / "journal.jsonl")
    journal.append(line(1), must_take_effect=False)
    journal.close()
    assert read_journal(tmp_path / "journal.jsonl") == ((line(0), line(1)), ())


def test_a_torn_last_line_is_set_aside(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    whole = (line(0).to_json() + "\n" + line(1).to_json() + "\n").encode()
    for cut in range(len(line(0).to_json()) + 2, len(whole) - 1):
        path.write_bytes(whole[:cut])
        found, remarks = read_journal(path)
        assert found[:1] == (line(0),)
        assert len(found) + len(remarks) == 2


def test_an_existing_journal_is_never_overwritten(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_text("mine")
    with pytest.raises(FileExistsError):
        Journal().open(path)
    assert path.read_text() == "mine"


FULL_DISK = """
import resource, signal, sys
from pathlib import Path
from madrob_console.errors import MadrobError
from madrob_console.referee.journal import Entry, Journal, Origin

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
journal = Journal()
journal.open(Path(sys.argv[1]))
resource.setrlimit(resource.RLIMIT_FSIZE, (150, resource.RLIM_INFINITY))
long = Entry(1.0, Origin.REFEREE, "note", reason="x" * 200)
try:
    journal.append(long, must_take_effect=False)
except MadrobError as error:
    print("refused:", error)
print("kept:", journal.append(Entry(2.0, Origin.REFEREE, "abort"), must_take_effect=True))
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
print("later:", journal.append(Entry(3.0, Origin.SYSTEM, "end"), must_take_effect=True))
"""


@pytest.mark.machine
def test_a_full_disk_refuses_a_note_but_no_abort_and_writes_it_later(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(path)],
        capture_output=True, text=True, check=True, env=os.environ,
    )  # fmt: skip
    refused, kept, later = done.stdout.splitlines()
    assert refused.startswith("refused: the journal cannot be written")
    assert kept.startswith("kept: the journal cannot be written")
    assert later == "later: None"
    found, _ = read_journal(path)
    assert [entry.what for entry in found] == ["abort", "end"]


def test_the_state_is_rebuilt_from_the_journal() -> None:
    def act(time: float, act: SetUp | Rule | Abort) -> Entry:
        return Entry(time, Origin.REFEREE, act.name, details=act_details(act))

    lines = [
        act(1.0, SetUp(SETUP)),
        Entry(2.0, Origin.REFEREE, "start"),
        Entry(7.0, Origin.CLOCK, Change.RUN_STARTS, details={"time": 7.0}),
        act(9.0, Rule(Step.TOUCH, confirmed=True, reason="seen")),
        Entry(
            20.0, Origin.CLOCK, Change.RUN_STOPS, reason="done",
            details={"outcome": "completed", "time": 19.0},
        ),
    ]  # fmt: skip
    run = rebuild([Entry.from_json(entry.to_json()) for entry in lines], handle_zero=5.9)
    assert (run.phase, run.outcome) == (Phase.STOPPED, Outcome.COMPLETED)
    assert (run.start, run.stop, run.handle_zero) == (7.0, 19.0, 5.9)
    assert run.setup == SETUP
    assert run.rulings[0].step is Step.TOUCH


def test_a_damaged_line_is_named() -> None:
    with pytest.raises(MadrobError, match="rule on a step"):
        act_of(Entry(1.0, Origin.REFEREE, "rule on a step", details={"step": 9}))
    with pytest.raises(MadrobError, match="run stops"):
        rebuild([Entry(1.0, Origin.CLOCK, "run stops", details={"outcome": "won"})])


@pytest.mark.parametrize("text", ["robot\u2028never touched", "a\x85b", "a\u2029b", "\udcff"])
def test_every_character_of_a_reason_survives(text: str, tmp_path: Path) -> None:
    journal, path = Journal(), tmp_path / "journal.jsonl"
    journal.open(path)
    entry = Entry(1.0, Origin.REFEREE, "note", reason=text)
    journal.append(entry, must_take_effect=False)
    journal.close()
    assert read_journal(path) == ((entry,), ())


def test_a_disk_that_does_not_sync_refuses_a_note_and_keeps_an_abort(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(_file: int) -> None:
        raise OSError(5, "Input/output error")

    journal, path = Journal(), tmp_path / "journal.jsonl"
    journal.open(path)
    monkeypatch.setattr(os, "fsync", broken)
    with pytest.raises(MadrobError, match="Input/output error"):
        journal.append(line(1), must_take_effect=False)
    assert journal.append(line(2), must_take_effect=True) is not None
    assert journal.pending == (line(2),)
    monkeypatch.undo()
    assert journal.append(line(3), must_take_effect=True) is None
    assert [e.what for e in read_journal(path)[0]][-2:] == ["line 2", "line 3"]
