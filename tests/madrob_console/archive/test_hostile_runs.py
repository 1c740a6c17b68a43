"""Whatever is wrong with the files of one run makes that run unreadable, and nothing else."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from madrob_console.archive.collection import collected_in
from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE, next_run_number
from madrob_console.archive.history import History
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.scored import open_run
from madrob_console.archive.unfinished import MOST_READ, find_unfinished, is_held
from madrob_console.cli.score_command import describe_run
from madrob_console.errors import MadrobError
from madrob_console.export.pack import export_team
from madrob_console.messages.codec import DEFAULT_MAPPINGS
from madrob_console.referee.journal import HOLD_FILE
from madrob_console.standings.competition import competition_standings
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.recorded_runs import copy_run

Spoil = Callable[[Path], None]

OF_PARSING = 50
"""Reading a journal of 15 000 lines takes up to 26 times as long as parsing them does."""

DIGITS = "9" * 400
METADATA = "metadata.yaml"


def _file_of(folder: Path, name: str) -> Path:
    return next(folder.glob(name))


def _put(name: str, content: bytes) -> Spoil:
    def spoil(folder: Path) -> None:
        _file_of(folder, name).write_bytes(content)

    return spoil


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _endless(path: Path) -> None:
    path.symlink_to("/dev/zero")


def _loop(path: Path) -> None:
    path.symlink_to(path)


def _folder(path: Path) -> None:
    path.mkdir()


def _huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(20 * 10**9)


def _placed(name: str, make: Callable[[Path], None]) -> Spoil:
    def spoil(folder: Path) -> None:
        path = _file_of(folder, name)
        path.unlink()
        make(path)

    return spoil


def _grown(name: str) -> Spoil:
    """Its content, and 20 GB of nothing behind it."""

    def spoil(folder: Path) -> None:
        with _file_of(folder, name).open("r+b") as file:
            file.truncate(20 * 10**9)

    return spoil


def _line(text: str) -> Spoil:
    """One more line in the journal."""

    def spoil(folder: Path) -> None:
        with (folder / JOURNAL_FILE).open("a") as file:
            file.write(text + "\n")

    return spoil


def _change(what: str, details: str, time: str = "1700000001.0") -> Spoil:
    return _line(
        f'{{"time": {time}, "origin": "system", "what": "{what}", "details": {{{details}}}}}'
    )


def _setup(key: str, value: str) -> Spoil:
    def spoil(folder: Path) -> None:
        path = folder / JOURNAL_FILE
        first, *rest = path.read_text().splitlines()
        entry = json.loads(first)
        entry["details"]["setup"][key] = "PLACE"
        path.write_text("\n".join([json.dumps(entry).replace('"PLACE"', value), *rest]) + "\n")

    return spoil


def _result(key: str, value: str) -> Spoil:
    def spoil(folder: Path) -> None:
        path = folder / RESULT_FILE
        content = json.loads(path.read_text()) | {key: "PLACE"}
        path.write_text(json.dumps(content).replace('"PLACE"', value))

    return spoil


def _million(folder: Path) -> None:
    line = '{"time": 1700000001.0, "origin": "sensor", "what": "event", "details": {"time": 1.0}}'
    with (folder / JOURNAL_FILE).open("a") as file:
        for _ in range(100):
            file.write(f"{line}\n" * 10_000)


def _yaml(content: str) -> Spoil:
    return _put(METADATA, content.encode())


BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{new}: &{new} [*{old},*{old},*{old},*{old},*{old},*{old},*{old},*{old},*{old}]\n"
    for old, new in zip("abcdefghij", "bcdefghijk", strict=True)
)

PLACES = {"pipe": _pipe, "endless": _endless, "loop": _loop, "folder": _folder, "huge": _huge}
FILES = {
    "journal": JOURNAL_FILE,
    "result": RESULT_FILE,
    "metadata": METADATA,
    "bag": "*.mcap",
    "run info": "run_info_*.yaml",
    "events": "*_event.csv",
}

CASES: dict[str, Spoil] = {
    **{
        f"{kind} as {what}": _placed(name, make)
        for what, name in FILES.items()
        for kind, make in PLACES.items()
    },
    **{f"{what} empty": _put(name, b"") for what, name in FILES.items()},
    "journal grown": _grown(JOURNAL_FILE),
    "result grown": _grown(RESULT_FILE),
    "bag grown": _grown("*.mcap"),
    "journal of 10^6 lines": _million,
    "journal of zeros": _put(JOURNAL_FILE, bytes(9_999)),
    "journal of one long line": _put(JOURNAL_FILE, b'{"time": 1, "what": "' + b"x" * 10**7),
    "journal nested": _put(JOURNAL_FILE, b'{"time":' + b"[" * 10**6 + b"\n"),
    "journal nested in details": _change("note", '"note": ' + "[" * 10**5 + "]" * 10**5),
    "time of 400 digits": _change("event", "", DIGITS),
    "time infinite": _change("event", "", "Infinity"),
    "time beyond floats": _change("event", "", "1e999"),
    "time no number": _change("event", "", "NaN"),
    "time as text": _change("event", "", '"Infinity"'),
    "time of an act too late": _change("note", '"note": "x"', "1e308"),
    "time of an act too early": _change("abort", '"reason": "x"', "-1e308"),
    "issue infinite": _change("result written", '"issue": Infinity'),
    "issue of 400 digits": _change("result written", f'"issue": {DIGITS}'),
    "issue no number": _change("result written", '"issue": [1]'),
    "stop of 400 digits": _change("run stops", f'"outcome": "completed", "time": {DIGITS}'),
    "stop of 290 digits": _change("run stops", f'"outcome": "completed", "time": {DIGITS[:290]}'),
    "stop no time": _change("run stops", '"outcome": "completed", "time": {}'),
    "outcome unknown": _change("run stops", '"outcome": "won", "time": 1700000001.0'),
    "fault of 1e308": _change("fault of the testbed", '"time": 1e308'),
    "step unknown": _change("rule on a step", '"step": 9, "confirmed": true, "reason": "x"'),
    "details no mapping": _line('{"time": 1, "origin": "system", "what": "note", "details": 3}'),
    "line no mapping": _line("[1, 2, 3]"),
    "set-up without end": _setup("timeout", "1e999"),
    "set-up of 400 digits": _setup("timeout", DIGITS),
    "set-up of no run": _setup("run_number", "-5"),
    "result infinite": _result("issue", "Infinity"),
    "result of 400 digits": _result("start", DIGITS),
    "result beyond floats": _result("start", "1e999"),
    "result no number": _result("stop", "NaN"),
    "result nested": _result("notes", "[" * 10**5 + "]" * 10**5),
    "result of a long team": _result("team", '"' + "x" * 10**6 + '"'),
    "result with a long digest": _result("files", '{"../../../etc/passwd": {"sha256": 1}}'),
    "metadata nested": _yaml("[" * 10**5),
    "metadata nested in blocks": _yaml("- " * 10**5),
    "metadata a bomb": _yaml(BOMB),
    "metadata no mapping": _yaml("- 1\n- 2\n"),
    "metadata of a date that is none": _yaml("rosbag2_bagfile_information: 2000-99-99\n"),
    "metadata that leads out": _yaml(
        "rosbag2_bagfile_information:\n  relative_file_paths: [../../../../dev/zero]\n"
    ),
    "metadata of many files": _yaml(
        "rosbag2_bagfile_information:\n  relative_file_paths: ["
        + ", ".join(f"f{number}.mcap" for number in range(50_000))
        + "]\n"
    ),
    "bag of zeros": _put("*.mcap", bytes(10**6)),
    "bag that claims much": _put("*.mcap", b"\x89MCAP0\r\n" + b"\x06" + b"\xff" * 8 + bytes(99)),
}


NO_LINES = {"journal empty", "journal of zeros", "journal of one long line", "journal nested"}
"""Journals in which no line can be read: of such a run nothing is known but its name."""


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A results folder with a run that nothing is wrong with."""
    copy_run(tmp_path / "results", 1)
    return tmp_path / "results"


def _words(use: Callable[[], object]) -> str | None:
    """What a `MadrobError` says; nothing else may be raised."""
    try:
        use()
    except MadrobError as error:
        return str(error)
    return None


@pytest.mark.parametrize(
    ("case", "cut_off"),
    [(case, cut) for case in CASES for cut in (False, True) if not cut or "result" not in case],
)
def test_a_spoilt_run_spoils_nothing_else(results: Path, case: str, *, cut_off: bool) -> None:
    (good,) = History(results).refresh()
    bad = copy_run(results, 2)
    CASES[case](bad)
    if cut_off:
        (bad / RESULT_FILE).unlink()
    name = bad.name

    for _ in range(2):  # the second time from what was kept
        listed = {run.folder: run for run in History(results).refresh()}
        assert listed.keys() == {good.folder, name}
        assert listed[good.folder] == good
    run = listed[name]
    asked = {found.folder: found.words for found in find_unfinished(results)}
    assert asked.keys() <= {name}
    if cut_off and case not in NO_LINES:
        assert (run.problem is not None) != (name in asked)  # asked about, or said why not
    assert next_run_number(results, run.subject, run.condition) == 3

    for check in (False, True):
        told = describe_run(RunPath(bad), check=check)
        if told.problem is not None:
            assert str(bad) in told.problem
            assert "report it" not in told.problem
    if (why := _words(lambda: open_run(bad))) is not None:
        assert str(bad) in why
        assert why.isprintable()
        assert "report it" not in why
    competition_standings([good, run], made=0.0, official=False)
    if "grown" not in case and "huge" not in case:
        export_team(collected_in(results), run.subject, DEFAULT_MAPPINGS, 0.0, practice=True)
        _words(lambda: export_team(collected_in(results), run.subject, DEFAULT_MAPPINGS, 0.0))


def test_a_folder_of_hostile_journals_is_looked_through_at_once(results: Path) -> None:
    """Each as long as a journal may be: those that are too many wait for those before them."""
    note = {"time": 1_700_000_001.0, "origin": "referee", "what": "note", "details": {"note": "x"}}
    line = json.dumps(note | {"reason": "x" * 600}) + "\n"
    for number in range(2, 8):
        run = copy_run(results, number)
        (run / RESULT_FILE).unlink()
        with (run / JOURNAL_FILE).open("a") as file:
            file.write(line * 15_000)
    journals = MOST_READ // (run / JOURNAL_FILE).stat().st_size
    lines = (run / JOURNAL_FILE).read_text().splitlines() * journals

    def parsing() -> float:
        began = time.process_time()
        for each in lines:
            json.loads(each)
        return time.process_time() - began

    before = parsing()
    began = time.process_time()
    found = find_unfinished(results)
    looking = time.process_time() - began
    assert len(found) == journals
    assert looking < OF_PARSING * (before + parsing()) / 2  # a busy machine is slow at both


def test_whoever_may_read_a_run_cannot_make_it_seem_to_go_on(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.start(make_setup())
    assert drive.engine.folder is not None
    journal = drive.engine.folder / JOURNAL_FILE
    assert is_held(journal)
    assert find_unfinished(tmp_path) == ()
    copy = tmp_path / "copy"
    shutil.copytree(journal.parent, copy)
    drive.engine.close()
    assert not is_held(journal)
    shutil.rmtree(journal.parent)
    copy.rename(journal.parent)  # as a machine that stopped leaves it
    with journal.open("rb") as stranger:
        fcntl.flock(stranger, fcntl.LOCK_EX)
        assert not is_held(journal)
        (found,) = find_unfinished(tmp_path)
        again = Drive(tmp_path)
        assert again.open(tmp_path / found.folder) is None
        assert is_held(journal)
        again.engine.close()


def test_a_run_of_an_older_version_that_goes_on_is_left_alone(results: Path) -> None:
    run = copy_run(results, 2)
    (run / RESULT_FILE).unlink()
    assert not (run / HOLD_FILE).exists()
    with (run / JOURNAL_FILE).open("r+b") as engine:
        fcntl.flock(engine, fcntl.LOCK_EX)
        assert is_held(run / JOURNAL_FILE)
        assert find_unfinished(results) == ()
    assert [found.folder for found in find_unfinished(results)] == [run.name]
