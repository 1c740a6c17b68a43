from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE, RESULT_FORMAT, RunName
from madrob_console.archive.history import (
    INDEX_FILE,
    History,
    RunSummary,
    earlier_runs,
)
from madrob_console.archive.result_reader import LARGEST_RESULT
from madrob_console.archive.run_filter import matches
from madrob_console.errors import MadrobError
from madrob_console.files.bounded import stamp_of
from madrob_console.files.plain import open_plain
from madrob_console.referee.acts import Abort, Finalise
from madrob_console.referee.on_record import TeamWord
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
from tests.madrob_console.engine.drive import Drive, make_setup
from tests.madrob_console.run_folders import EPOCH, document, summary, write

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


def test_a_run_of_the_engine_reads_as_its_result_says(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.whole_run(make_setup())
    drive.act(Finalise(TeamWord.PROTESTED, "R. Eferee", "dark"))
    assert drive.engine.scored is not None
    result = drive.engine.scored.result
    (run,) = History(tmp_path).refresh()
    assert run.problem is None
    assert (run.subject, run.team, run.condition, run.run_number) == (3, "Delft", 1, 1)
    assert run.started == result.start
    assert run.values == {
        name: i.value for name, i in result.indicators.items() if i.value is not None
    }
    assert len(run.values) == len(IndicatorName)
    assert (run.outcome, run.valid) == (Outcome.COMPLETED, True)
    assert (run.source, run.official) == ("simulated", False)
    assert (run.final, run.team_word, run.closing) == (True, "protested", "protested")
    assert run.ruleset == "protocol"


def test_an_aborted_run_and_one_that_goes_on_are_listed_as_such(tmp_path: Path) -> None:
    drive = Drive(tmp_path)
    drive.start(make_setup())
    drive.wait(1.0)
    drive.act(Abort("the robot burns"))
    drive.finish()
    history = History(tmp_path)
    (aborted,) = history.refresh()
    assert (aborted.outcome_word, aborted.valid, aborted.values) == ("INVALID", False, {})
    drive.start(make_setup(run_number=2))
    before, now = history.refresh()
    assert before == aborted
    assert (now.outcome, now.outcome_word, now.problem) == (None, "unfinished", None)
    assert (now.team, now.run_number, now.ruleset) == ("Delft", 2, "protocol")
    assert not now.valid


@given(RUNS)
def test_a_summary_says_what_its_result_says(run: RunSummary) -> None:
    with tempfile.TemporaryDirectory() as root:
        write(Path(root), run)
        history = History(Path(root))
        assert history.refresh() == (run,)
        assert history.refresh() == (run,)
        assert History(Path(root)).refresh() == (run,)


@pytest.mark.parametrize("outcome", list(Outcome))
def test_a_run_that_does_not_count_says_why(tmp_path: Path, outcome: Outcome) -> None:
    content = document(summary(outcome=outcome)) | {"outcome_reason": "a visitor " + "x" * 9999}
    path = write(tmp_path, summary(outcome=outcome))
    path.write_text(json.dumps(content))
    read, again = History(tmp_path).refresh()[0], History(tmp_path).refresh()[0]
    assert read == again
    if read.valid:
        assert read.reason == ""
    else:
        assert read.reason.startswith("a visitor xxx")
        assert len(read.reason) == 500


def test_runs_come_oldest_first_and_strangers_are_skipped(tmp_path: Path) -> None:
    later, earlier = summary(run_number=1, hour=2.0), summary(run_number=2, hour=1.0)
    write(tmp_path, later)
    write(tmp_path, earlier)
    (tmp_path / "notes").mkdir()
    (tmp_path / RunName(1, 1, 1).folder_name(EPOCH)).write_text("a file")
    (tmp_path / RunName(2, 1, 1).folder_name(EPOCH)).symlink_to(tmp_path / later.folder)
    (tmp_path / "subject_001_cond_001_run_001_20239999_000000").mkdir()
    assert History(tmp_path).refresh() == (earlier, later)


def test_an_empty_or_missing_results_folder_has_no_runs_and_stays_as_it_is(tmp_path: Path) -> None:
    assert History(tmp_path / "none").refresh() == ()
    assert History(tmp_path).refresh() == ()
    assert list(tmp_path.iterdir()) == []


def test_a_results_folder_that_cannot_be_read_is_one_clear_line(tmp_path: Path) -> None:
    root = tmp_path / "results"
    root.write_text("a file")
    with pytest.raises(MadrobError, match="choose another results folder"):
        History(root).refresh()


def test_a_run_that_was_cut_off_is_known_by_its_folder_and_its_journal(tmp_path: Path) -> None:
    run = summary()
    folder = tmp_path / run.folder
    folder.mkdir()
    (bare,) = History(tmp_path).refresh()
    assert (bare.subject, bare.condition, bare.run_number, bare.team) == (3, 7, 1, "")
    assert bare.started == EPOCH
    for torn in (b"", b"{", b'{"details": {}}\n', b"\xff\n", b"[" * 99_999):
        (folder / "journal.jsonl").write_bytes(torn)
        assert History(tmp_path).refresh() == (bare,)


# ---------------------------------------------------------------- what is wrong


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
        (changed(closure={"team_word": 3}), "damaged"),
        (changed(condition_number=21), "damaged"),
        (changed(format=RESULT_FORMAT + 1, outcome=7), "use a newer madrob-console"),
        (changed(subject=4), "is of subject 4, condition 7, run 1: put it back"),
    ],
)
def test_a_result_that_cannot_be_used_says_why_and_what_to_do(
    tmp_path: Path, content: bytes, words: str
) -> None:
    path = write(tmp_path, summary())
    path.write_bytes(content)
    (run,) = History(tmp_path).refresh()
    assert run.problem is not None
    assert words in run.problem
    assert "`madrob recover`" in run.problem or "damaged" not in run.problem
    assert len(run.problem) < 250
    assert (run.subject, run.condition, run.run_number, run.started) == (3, 7, 1, EPOCH)
    assert (run.outcome_word, run.valid) == ("DAMAGED", False)


def test_a_result_of_no_sane_size_is_not_read(tmp_path: Path) -> None:
    path = write(tmp_path, summary())
    with path.open("ab") as file:
        file.truncate(100 * LARGEST_RESULT)  # nearly all of it is a hole
    (run,) = History(tmp_path).refresh()
    assert run.problem is not None
    assert "has 1000 MB, too much for a result" in run.problem


@pytest.mark.parametrize("place", ["link", "pipe", "folder"])
def test_what_is_no_plain_file_is_not_followed_and_blocks_nothing(
    tmp_path: Path, place: str
) -> None:
    path = write(tmp_path / "results", summary())
    outside = path.rename(tmp_path / "outside.json")
    make: dict[str, Callable[[], None]] = {
        "link": lambda: path.symlink_to(outside),
        "pipe": lambda: os.mkfifo(path),
        "folder": path.mkdir,
    }
    make[place]()
    (run,) = History(tmp_path / "results").refresh()
    assert run.problem is not None
    assert "cannot be read" in run.problem
    assert run.team == ""


@given(st.binary(max_size=200) | JSON.map(lambda value: json.dumps(value).encode()))
@example(b'{"format": 1e400}')
def test_no_content_of_a_result_file_is_an_exception(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as root:
        write(Path(root), summary()).write_bytes(content)
        (run,) = History(Path(root)).refresh()
        assert run.problem
        assert run.words


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


# ---------------------------------------------------------------- the index


def refreshed(
    history: History, monkeypatch: pytest.MonkeyPatch
) -> tuple[tuple[RunSummary, ...], int]:
    """The runs, and how many files of runs were opened for them."""
    opened: list[str] = []

    def counted(path: str | Path) -> int:
        opened.append(str(path))
        return open_plain(path)

    with monkeypatch.context() as patched:
        patched.setattr("madrob_console.files.bounded.open_plain", counted)
        runs = history.refresh()
    return runs, sum(not path.endswith(INDEX_FILE) for path in opened)


def test_a_result_that_did_not_change_is_not_read_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = summary(team="Delft")
    write(tmp_path, run)
    history = History(tmp_path)
    (first, opened) = refreshed(history, monkeypatch)
    assert first == (run,)
    assert opened > 0
    for again in (history, History(tmp_path)):
        assert refreshed(again, monkeypatch) == ((run,), 0)
    (tmp_path / INDEX_FILE).unlink()
    assert refreshed(History(tmp_path), monkeypatch) == ((run,), opened)


def test_a_result_that_was_changed_with_its_old_size_and_time_is_read_again(tmp_path: Path) -> None:
    path = write(tmp_path, summary(team="Delft"))
    history = History(tmp_path)
    history.refresh()
    before = path.stat()
    while path.stat().st_ctime_ns == before.st_ctime_ns:  # a clock of 4 ms
        path.write_text(path.read_text().replace("Delft", "Ghent"))
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.stat().st_size == before.st_size
    assert path.stat().st_mtime_ns == before.st_mtime_ns
    assert history.refresh()[0].team == "Ghent"
    assert History(tmp_path).refresh()[0].team == "Ghent"


def test_a_result_that_changed_is_read_again(tmp_path: Path) -> None:
    history = History(tmp_path)
    for issue in (1, 2, 10):
        run = summary(issue=issue)
        path = write(tmp_path, run)
        os.utime(path, ns=(issue, issue))
        assert history.refresh() == (run,)
        assert History(tmp_path).refresh() == (run,)
    path.unlink()
    assert history.refresh()[0].outcome is None
    path.parent.rmdir()
    assert history.refresh() == ()
    assert History(tmp_path).refresh() == ()


def foreign(index: list[Any]) -> object:
    return [[99, 1], index[1]]


def renamed(index: list[Any]) -> object:
    other = summary(subject=5).folder
    return [index[0], {summary().folder: [index[1][summary().folder][0], {"folder": other}]}]


@pytest.mark.parametrize(
    "spoil", [foreign, renamed, lambda _i: {}, lambda _i: [[1, 1], {"x": 3}], lambda i: i[1]]
)
def test_a_damaged_or_foreign_index_is_made_again(
    tmp_path: Path, spoil: Callable[[list[Any]], object]
) -> None:
    run = summary()
    write(tmp_path, run)
    History(tmp_path).refresh()
    index = tmp_path / INDEX_FILE
    good = index.read_bytes()
    for bad in (json.dumps(spoil(json.loads(good))).encode(), good[:-5], b"", b"\xff", b"[" * 9999):
        index.write_bytes(bad)
        assert History(tmp_path).refresh() == (run,)
        assert index.read_bytes() == good


def test_an_index_that_cannot_be_kept_is_no_problem(tmp_path: Path) -> None:
    run = summary()
    write(tmp_path, run)
    (tmp_path / INDEX_FILE / "in the way").mkdir(parents=True)
    assert History(tmp_path).refresh() == (run,)
    assert sorted(path.name for path in tmp_path.iterdir()) == [INDEX_FILE, run.folder]


def test_an_index_that_is_a_link_is_replaced_and_what_it_led_to_stays(tmp_path: Path) -> None:
    outside = tmp_path / "outside"
    outside.write_text("precious")
    root = tmp_path / "results"
    run = summary()
    write(root, run)
    (root / INDEX_FILE).symlink_to(outside)
    assert History(root).refresh() == (run,)
    assert outside.read_text() == "precious"


def test_a_problem_is_not_kept_for_the_next_program(tmp_path: Path) -> None:
    write(tmp_path, summary()).write_bytes(changed(format=RESULT_FORMAT + 1))
    assert History(tmp_path).refresh()[0].problem
    assert not (tmp_path / INDEX_FILE).exists()


def test_several_threads_may_read_at_once(tmp_path: Path) -> None:
    runs = tuple(summary(run_number=number, hour=number) for number in range(1, 30))
    for run in runs:
        write(tmp_path, run)
    history = History(tmp_path)
    read: list[tuple[RunSummary, ...]] = []
    threads = [
        threading.Thread(target=lambda: read.append(history.refresh())) for _thread in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert read == [runs] * 4


@pytest.mark.machine
def test_reading_runs_needs_no_numeric_library() -> None:
    modules = (
        "madrob_console.archive.history, madrob_console.archive.result_document, "
        "madrob_console.standings.tally, "
        "madrob_console.ui.panes.history_pane"
    )
    check = "[m for m in ('numpy', 'scipy', 'pandas', 'recorder', 'rclpy') if m in sys.modules]"
    done = subprocess.run(
        [sys.executable, "-c", f"import sys, {modules}; print({check})"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.slow
def test_10000_runs_come_from_the_index_in_little_more_than_a_look_at_each_file(
    tmp_path: Path,
) -> None:
    count = 10_000
    for number in range(count):
        write(tmp_path, summary(number // 200 + 1, number % 20 + 1, number // 20 % 10 + 1))

    def cpu_of_index() -> float:
        before = time.process_time()
        assert len(History(tmp_path).refresh()) == count
        return time.process_time() - before

    def cpu_of_looks() -> float:
        before = time.process_time()
        for folder in tmp_path.iterdir():
            for file in (RESULT_FILE, JOURNAL_FILE):
                stamp_of(f"{folder}/{file}")
        return time.process_time() - before

    cpu_of_index()  # reads each result
    assert min(cpu_of_index() / cpu_of_looks() for _ in range(5)) < 5


# ---------------------------------------------------------------- which runs


def test_a_run_compares_with_earlier_completed_ones_of_the_same_robot_and_condition() -> None:
    good = [summary(hour=1), summary(hour=2)]
    others = [
        summary(hour=3),  # the run itself and later ones
        summary(hour=4),
        summary(subject=4, hour=1),
        summary(condition=8, hour=1),
        summary(hour=1, outcome=Outcome.TIMEOUT),
        summary(hour=1, outcome=Outcome.ABORTED),
        summary(hour=1, outcome=Outcome.INTERRUPTED),
        summary(hour=1, outcome=None),
        summary(hour=1, voided=True),
        summary(hour=1, problem="damaged"),
        summary(hour=1, source="simulated"),
        summary(hour=1, source="replay"),
    ]
    itself = others[0]
    found = earlier_runs(
        [*others, *good], 3, 7, itself.started, competition="Autumn Cup", practice=False
    )
    assert found == tuple(good)
    (practice,) = earlier_runs(
        [*others, *good], 3, 7, itself.started, competition="Autumn Cup", practice=True
    )
    assert practice.source == "simulated"


def test_a_team_of_this_number_in_another_competition_is_another_team() -> None:
    runs = [summary(hour=1), summary(hour=2, competition="Spring Cup")]
    for cup, run in zip(("Autumn Cup", "Spring Cup"), runs, strict=True):
        assert earlier_runs(runs, 3, 7, EPOCH + 1e9, competition=cup, practice=False) == (run,)


def test_a_run_says_of_which_competition_it_is_with_a_result_and_without(tmp_path: Path) -> None:
    drive = Drive(tmp_path, competition="Autumn Cup")
    history = History(tmp_path)
    drive.start(make_setup())
    assert [run.competition for run in history.refresh()] == ["Autumn Cup"]  # it goes on
    drive.finish()
    drive.engine.close()
    assert [run.competition for run in history.refresh()] == ["Autumn Cup"]
    (drive.folder / "result.json").write_text("{")
    (damaged,) = history.refresh()
    assert (damaged.outcome_word, damaged.competition) == ("DAMAGED", "Autumn Cup")
    (drive.folder / "journal.jsonl").unlink()
    (unknown,) = history.refresh()
    assert unknown.competition is None


def test_runs_under_other_rules_do_not_compare_where_the_rules_are_given() -> None:
    runs = [summary(hour=1, ruleset="protocol"), summary(hour=2, ruleset="eurobench-2020")]
    of = partial(earlier_runs, runs, 3, 7, EPOCH + 1e9, competition="Autumn Cup", practice=False)
    assert len(of()) == 2
    (same,) = of(ruleset="eurobench-2020")
    assert same.ruleset == "eurobench-2020"


@pytest.mark.parametrize("condition", [0, 21, 999])
def test_a_folder_of_a_condition_that_does_not_exist_is_listed(
    tmp_path: Path, condition: int
) -> None:
    (tmp_path / RunName(3, condition, 1).folder_name(EPOCH)).mkdir()
    (run,) = History(tmp_path).refresh()
    assert run.condition == condition
    assert matches(run, f"cond:{condition}") or condition == 0
