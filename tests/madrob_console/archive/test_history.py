from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from unittest.mock import Mock

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.archive import unfinished_runs
from madrob_console.archive.collection import collected_in
from madrob_console.archive.folders import (
    JOURNAL_FILE,
    RESULT_FILE,
    RESULT_FORMAT,
    RunName,
    next_run_number,
)
from madrob_console.archive.history import History, earlier_runs
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.scored import open_run
from madrob_console.archive.unfinished_runs import MOST_READ, find_unfinished, is_held
from madrob_console.cli.batch import tried
from madrob_console.cli.score_command import describe_run
from madrob_console.common.errors import MadrobError
from madrob_console.common.plain_files import open_plain
from madrob_console.export.contents import team_contents
from madrob_console.export.pack import pack
from madrob_console.pages.competition import competition_standings
from madrob_console.referee.journal import HOLD_FILE
from madrob_console.referee.run_summary import RunSummary
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
from tests.madrob_console.engine.drive import STEP, Drive
from tests.madrob_console.recorded_runs import copy_run, final
from tests.madrob_console.run_folders import EPOCH, document, put_hole, summary, write

NUMBERS = st.integers(1, 999)
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=60)
RUNS = st.builds(
    summary,
    subject=NUMBERS,
    condition=st.integers(1, 20),
    run_number=NUMBERS,
    hour=st.floats(0, 1e5),
    team=TEXTS,
    outcome=st.sampled_from(Outcome),
    values=st.dictionaries(
        st.sampled_from([str(name) for name in IndicatorName]),
        st.floats(allow_nan=False, allow_infinity=False),
    ),
    issue=st.integers(1, 99),
    source=st.sampled_from(["ros", "simulated", "replay"]),
    competition=TEXTS,
)
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | TEXTS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=6,
)


# ---------------------------------------------------------------- what is read


@given(st.lists(RUNS, max_size=2, unique_by=lambda run: run.started))
def test_a_summary_says_what_its_result_says_oldest_first(runs: list[RunSummary]) -> None:
    with tempfile.TemporaryDirectory() as root:
        for run in runs:
            write(Path(root), run)
        history, ordered = History(Path(root)), tuple(sorted(runs, key=lambda run: run.started))
        assert history.refresh() == history.refresh() == ordered
        assert History(Path(root)).refresh() == ordered


def test_strangers_are_skipped(tmp_path: Path) -> None:
    write(tmp_path, summary())
    (tmp_path / "notes").mkdir()
    (tmp_path / RunName(1, 1, 1).folder_name(EPOCH)).write_text("a file")
    (tmp_path / RunName(2, 1, 1).folder_name(EPOCH)).symlink_to(tmp_path / summary().folder)
    (tmp_path / "subject_001_cond_001_run_001_20239999_000000").mkdir()
    assert History(tmp_path).refresh() == (summary(),)


@pytest.mark.parametrize("outcome", list(Outcome))
def test_a_run_that_does_not_count_says_why(tmp_path: Path, outcome: Outcome) -> None:
    content = document(summary(outcome=outcome)) | {"outcome_reason": "a visitor " + "x" * 9999}
    write(tmp_path, summary(outcome=outcome)).write_text(json.dumps(content))
    (read,), (again,) = History(tmp_path).refresh(), History(tmp_path).refresh()
    assert read == again
    assert len(read.reason) == (0 if read.valid else 500)
    assert "a visitor xxx".startswith(read.reason[:13])


# ---------------------------------------------------------------- what is wrong


NO_MAPPING = {"signal": "latch", "topic": "/t", "type": "std_msgs/msg/Bool", "field": "a b"}


def changed(**fields: object) -> bytes:
    return json.dumps(document(summary()) | fields).encode()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "damaged"),
        (b"{", "damaged"),
        (b"[1]", "damaged"),
        (b'{"a": "\xff"}', "damaged"),
        (b"[" * 1_000_000, "damaged"),
        (b'{"format": 1, "x": ' + b"[" * 100_000, "damaged"),
        (changed()[:-20], "damaged"),
        (changed(format="1"), "damaged"),
        (changed(issue="one"), "damaged"),
        (changed(outcome="x" * 1_000_000), "damaged"),
        (changed(team="x" * 100_000), "damaged"),
        (changed(start=1e300), "damaged"),
        (changed(start=None), "damaged"),
        (changed(indicators={"execution_time": {"value": "fast"}}), "damaged"),
        (changed(indicators=[]), "damaged"),
        (changed(indicators={"capability_level": {"value": 2**70}}), "damaged"),
        (changed(issue=2**70), "damaged"),
        (changed(closure={"team_word": 3}), "damaged"),
        (changed(condition_number=21), "damaged"),
        (changed(mappings=[NO_MAPPING]), "damaged ('a b' is no field"),
        (changed(format=RESULT_FORMAT + 1, outcome=7), "use a newer madrob-console"),
        (changed(subject=4), "is of subject 4, condition 7, run 1: put it back"),
    ],
)
def test_a_result_that_cannot_be_used_says_why_and_what_to_do(
    tmp_path: Path, content: bytes, words: str
) -> None:
    write(tmp_path, summary()).write_bytes(content)
    (run,) = History(tmp_path).refresh()
    problem = str(run.problem)
    assert words in problem
    assert ("damaged" in problem) <= ("`madrob recover`" in problem)
    assert len(problem) < 250
    damaged = summary(problem=problem, source=None)
    same = ("subject", "condition", "run_number", "started", "problem", "outcome_word", "valid")
    assert {name: getattr(run, name) for name in same} == {
        name: getattr(damaged, name) for name in same
    }


def test_a_result_that_another_version_wrote_is_not_called_damaged(results: Path) -> None:
    result, journal = (next(results.glob(f"*/{name}")) for name in (RESULT_FILE, JOURNAL_FILE))
    before = result.read_bytes()
    after = before.replace(b'"outcome": "timeout"', b'"outcome": "won"')
    result.write_bytes(after)
    old, new = (hashlib.sha256(content).hexdigest() for content in (before, after))
    journal.write_text(journal.read_text().replace(old, new))
    (run,) = History(results).refresh()
    assert "use the madrob-console that wrote it" in str(run.problem)
    assert (run.repairable, run.valid) == (False, False)


@given(st.sampled_from(sorted(document(summary()))), JSON)
def test_a_wrong_value_in_a_result_is_an_unknown_or_a_problem_in_words(
    field: str, value: object
) -> None:
    with tempfile.TemporaryDirectory() as root:
        write(Path(root), summary()).write_bytes(changed(**{field: value}))
        (run,) = History(Path(root)).refresh()
        assert (run.subject, run.condition, run.run_number) == (3, 7, 1)
        assert run.problem is not None or run.outcome is not None
        assert run.words


# ---------------------------------------------------------------- what is read again


def test_a_run_that_has_not_changed_is_not_read_again(
    many: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    history, opened = History(many), Mock(side_effect=open_plain)
    assert history.refresh() == MANY
    monkeypatch.setattr("madrob_console.common.plain_files.open_plain", opened)
    assert history.refresh() == MANY
    opened.assert_not_called()
    path = write(many, summary(run_number=40, hour=40))
    assert len(history.refresh()) == len(MANY) + 1
    assert {Path(call.args[0]).parent for call in opened.call_args_list} == {path.parent}


def test_a_result_that_changed_is_read_again_also_with_its_old_size_and_time(
    tmp_path: Path,
) -> None:
    history = History(tmp_path)
    for issue in (1, 2, 10):
        run = summary(issue=issue)
        path = write(tmp_path, run)
        os.utime(path, ns=(issue, issue))
        assert history.refresh() == History(tmp_path).refresh() == (run,)
    before = path.stat()
    while path.stat().st_ctime_ns == before.st_ctime_ns:  # a clock of 4 ms
        path.write_text(path.read_text().replace("Team 3", "Teem 3"))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.stat().st_size == before.st_size
    assert history.refresh()[0].team == History(tmp_path).refresh()[0].team == "Teem 3"
    path.unlink()
    assert history.refresh()[0].outcome is None
    path.parent.rmdir()
    assert history.refresh() == History(tmp_path).refresh() == ()


MANY = tuple(summary(run_number=number, hour=number) for number in range(1, 40))


@pytest.fixture
def many(tmp_path: Path) -> Path:
    for run in MANY:
        write(tmp_path, run)
    return tmp_path


def test_several_threads_may_read_at_once(many: Path) -> None:
    history = History(many)
    with ThreadPoolExecutor(4) as threads:
        reading = [threads.submit(history.refresh) for _thread in range(4)]
    assert [one.result() for one in reading] == [MANY] * 4


# ---------------------------------------------------------------- which runs


COMPARED: dict[str, tuple[dict[str, object], RunSummary]] = {
    "official": ({}, summary(hour=1)),
    "practice": ({"practice": True}, summary(hour=1, source="simulated")),
    # another team has this number there
    "elsewhere": ({"competition": "Spring Cup"}, summary(hour=1, competition="Spring Cup")),
    "other rules": ({"ruleset": "eurobench-2020"}, summary(hour=1, ruleset="eurobench-2020")),
}


@pytest.mark.parametrize("kind", COMPARED)
def test_a_run_compares_with_earlier_completed_ones_of_the_same_robot_and_condition(
    kind: str,
) -> None:
    runs = [
        summary(hour=3),  # the run itself and later ones
        summary(hour=4),
        summary(subject=4, hour=1),
        summary(condition=8, hour=1),
        *(summary(hour=1, outcome=one) for one in (*Outcome, None) if one != Outcome.COMPLETED),
        summary(hour=1, voided=True),
        summary(hour=1, problem="damaged"),
        summary(hour=1, source="replay"),
        *(run for _, run in COMPARED.values()),
    ]
    asked, expected = COMPARED[kind]
    of = {"competition": "Autumn Cup", "practice": False, "ruleset": "protocol", **asked}
    assert earlier_runs(runs, 3, 7, runs[0].started, **of) == (expected,)  # type: ignore[arg-type]


Spoil = Callable[[Path], object]

OF_PARSING = 50
"""Reading a journal of 3 000 lines takes up to 26 times as long as parsing them does."""

SCALE = 5

DIGITS = "9" * 400
METADATA = "metadata.yaml"


def _put(name: str, content: bytes) -> Spoil:
    return lambda folder: next(folder.glob(name)).write_bytes(content)


def _grown(name: str) -> Spoil:
    """Its content, and 20 GB of nothing behind it."""
    return lambda folder: os.truncate(next(folder.glob(name)), 20 * 10**9)


def _placed(name: str, make: Callable[[Path], object]) -> Spoil:
    def replaced(folder: Path) -> None:
        (path,) = folder.glob(name)
        path.unlink()
        make(path)

    return replaced


def _line(text: str) -> Spoil:
    """One more line in the journal, or more of them."""
    return lambda folder: put_lines(folder / JOURNAL_FILE, text + "\n")


def put_lines(journal: Path, lines: str) -> None:
    with journal.open("a") as file:
        file.write(lines)


EVENT = '{"time": 1700000001.0, "origin": "system", "what": "event", "details": {"time": 1.0}}'


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


def _yaml(content: str) -> Spoil:
    return _put(METADATA, content.encode())


BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{new}: &{new} [*{old},*{old},*{old},*{old},*{old},*{old},*{old},*{old},*{old}]\n"
    for old, new in zip("abcdefghij", "bcdefghijk", strict=True)
)

PLACES: dict[str, Callable[[Path], object]] = {
    "pipe": os.mkfifo,
    "endless": lambda path: path.symlink_to("/dev/zero"),
    "loop": lambda path: path.symlink_to(path),
    "link": lambda path: path.symlink_to(next(path.parents[1].glob(f"*_run_001_*/{path.name}"))),
    "folder": Path.mkdir,
    "huge": put_hole,
}
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
    "journal of 10^6 lines": _line("\n".join([EVENT] * 10**6)),
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
        + ", ".join(f"f{number}.mcap" for number in range(10_000))
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


def no_report(_run: Path) -> tuple[dict[str, bytes], list[str]]:
    return {}, []


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
    if case in {f"result as {place}" for place in (*PLACES, "empty")} | {"result grown"}:
        assert (run.outcome_word, run.valid) == ("DAMAGED", False)
    asked = {found.folder: found.words for found in find_unfinished(results)}
    assert asked.keys() <= {name}
    if cut_off and case not in NO_LINES:
        assert (run.problem is not None) != (name in asked)  # asked about, or said why not
    assert next_run_number(results, run.subject, run.condition) == 3

    said = [
        told.problem
        for check in (False, True)
        if (told := tried(RunPath(bad), work=partial(describe_run, check=check))).problem
    ]
    try:
        open_run(bad)
    except MadrobError as error:
        said.append(str(error))
    for why in said:
        assert (str(bad) in why, "report it" in why, why.isprintable()) == (True, False, True)
    competition_standings([good, run], made=0.0, official=False)
    if "grown" not in case and "huge" not in case:
        found, subject = collected_in(results), run.subject
        pack(team_contents(found, subject, 0.0, practice=True), no_report)
        with suppress(MadrobError):
            pack(team_contents(found, subject, 0.0), no_report)


def test_a_folder_of_hostile_journals_is_looked_through_at_once(
    results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each as long as a journal may be, but for a scale: the others wait for those before them."""
    lines = 15_000 // SCALE
    monkeypatch.setattr(unfinished_runs, "MOST_READ", MOST_READ // SCALE)
    note = {"time": 1_700_000_001.0, "origin": "referee", "what": "note", "details": {"note": "x"}}
    line = json.dumps(note | {"reason": "x" * 600}) + "\n"
    for number in range(2, 8):
        run = copy_run(results, number)
        (run / RESULT_FILE).unlink()
        put_lines(run / JOURNAL_FILE, line * lines)
    journals = MOST_READ // SCALE // (run / JOURNAL_FILE).stat().st_size
    began = time.process_time()
    for _ in range(journals * lines):
        json.loads(line)
    parsed = time.process_time()
    assert len(find_unfinished(results)) == journals > 1
    assert time.process_time() - parsed < OF_PARSING * (parsed - began)


def test_a_locked_journal_goes_on_only_where_an_older_version_recorded_it(
    results: Path,
) -> None:
    """Whoever may read a run of today cannot make it seem to go on."""
    run = copy_run(results, 2)
    (run / RESULT_FILE).unlink()
    journal = run / JOURNAL_FILE
    with journal.open("r+b") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        assert is_held(journal)
        assert find_unfinished(results) == ()
        (run / HOLD_FILE).touch(0o600)  # as a machine that stopped leaves it
        assert not is_held(journal)
        assert [found.folder for found in find_unfinished(results)] == [run.name]


def test_a_run_whose_journal_lacks_lines_is_damaged_also_while_a_console_shows_it(
    tmp_path: Path,
) -> None:
    folder = shutil.copytree(final(), tmp_path / "results" / final().name)
    (folder / JOURNAL_FILE).write_text('{"time": 1}\n')
    drive = Drive(folder.parent)
    assert drive.open(folder) is None
    drive.wait(STEP)
    (run,) = History(folder.parent).refresh()
    drive.engine.close()
    assert (run.outcome, "is not what the journal says" in (run.problem or "")) == (None, True)
