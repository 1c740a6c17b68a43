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


def test_several_lines_are_brought_to_the_disk_by_one_sync(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal, synced = Journal(), list[int]()
    journal.open(tmp_path / "journal.jsonl")
    monkeypatch.setattr(os, "fsync", synced.append)
    assert journal.append([line(0), line(1)]) == 2
    assert journal.append([]) == 0
    assert len(synced) == 1
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
from madrob_console.referee.journal import Entry, Journal, Origin

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
journal = Journal()
journal.open(Path(sys.argv[1]))
resource.setrlimit(resource.RLIMIT_FSIZE, (150, resource.RLIM_INFINITY))
long = Entry(1.0, Origin.REFEREE, "note", reason="x" * 200)
print(journal.append([long]), journal.refused.strerror)
print(journal.append([Entry(2.0, Origin.REFEREE, "abort"), long]), journal.refused.strerror)
resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
print(journal.append([Entry(3.0, Origin.SYSTEM, "end")]), journal.refused)
"""


@pytest.mark.machine
def test_a_full_disk_takes_the_lines_that_it_has_room_for_and_no_part_of_one(
    tmp_path: Path,
) -> None:
    path = tmp_path / "journal.jsonl"
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(path)],
        capture_output=True, text=True, check=True, env=os.environ,
    )  # fmt: skip
    assert done.stdout.splitlines() == [
        "0 No space left on device",
        "1 No space left on device",
        "1 None",
    ]
    found, remarks = read_journal(path)
    assert [entry.what for entry in found] == ["abort", "end"]
    assert remarks == ()


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
    assert journal.append([entry]) == 1
    journal.close()
    assert read_journal(path) == ((entry,), ())


def test_what_the_disk_took_and_could_not_sync_is_no_part_of_the_journal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal, path = Journal(), tmp_path / "journal.jsonl"
    journal.open(path)
    assert journal.append([line(0)]) == 1
    monkeypatch.setattr(os, "fsync", broken)
    assert journal.append([line(1), line(2)]) == 0
    assert journal.refused is not None
    assert journal.refused.strerror == "Input/output error"
    assert read_journal(path) == ((line(0),), ())
    monkeypatch.undo()
    assert journal.append([line(2), line(3)]) == 2
    assert journal.refused is None
    assert read_journal(path) == ((line(0), line(2), line(3)), ())


def test_where_nothing_can_be_taken_back_a_line_withdraws_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal, path = Journal(), tmp_path / "journal.jsonl"
    journal.open(path)
    assert journal.append([line(0)]) == 1
    monkeypatch.setattr(os, "ftruncate", broken)
    with monkeypatch.context() as sick:
        sick.setattr(os, "fsync", broken)
        assert journal.append([line(1), line(2)]) == 0
        assert journal.append([line(1), line(2)]) == 0
    assert journal.append([line(2), line(3)]) == 2
    what = [entry.what for entry in read_journal(path)[0] if entry.what != "withdrawn"]
    assert what == ["line 0", "line 2", "line 3"]


def broken(*_arguments: object) -> None:
    raise OSError(5, "Input/output error")


def act(number: int, name: str = "finalise") -> Entry:
    return Entry(float(number), Origin.REFEREE, name, id=f"id {number}")


def withdrawn(**details: object) -> Entry:
    return Entry(9.0, Origin.SYSTEM, "withdrawn", details=details)


@pytest.mark.parametrize(
    ("lines", "stand"),
    [
        ([line(0), act(1), line(2), withdrawn(id="id 1")], [line(0), line(2)]),
        ([act(1), withdrawn(id="id 1"), act(1)], [act(1)]),
        ([act(1), withdrawn(id="id 2")], [act(1)]),
        ([act(1), withdrawn()], [act(1)]),
        ([line(0), line(1), withdrawn(lines=1)], [line(0)]),
        ([line(0), withdrawn(lines=10**9)], []),
        ([line(0), withdrawn(lines=-5)], [line(0)]),
        ([line(0), withdrawn(lines="all", id=["id 1"])], [line(0)]),
    ],
)
def test_what_was_withdrawn_counts_for_nobody_who_reads(
    lines: list[Entry], stand: list[Entry], tmp_path: Path
) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_text("".join(one.to_json() + "\n" for one in lines))
    found, remarks = read_journal(path)
    assert [entry for entry in found if entry.what != "withdrawn"] == stand
    assert remarks == ()
