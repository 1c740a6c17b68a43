"""The evidence beside what is scored: repaired where it was cut off, thinned, opened by no list."""

from __future__ import annotations

import errno
import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag2 import Reader

from madrob_console.archive.check import check_run
from madrob_console.archive.evidence import (
    RunEvidence,
    TidyLimits,
    evidence_at,
    remove_evidence,
    run_going_on,
)
from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE, RunPath
from madrob_console.archive.history import History
from madrob_console.archive.history_index import INDEX_FILE
from madrob_console.archive.repair import repair
from madrob_console.archive.run_journal import read_run_journal
from madrob_console.cli.main import main
from madrob_console.cli.repairing import repair_all
from madrob_console.common.errors import MadrobError
from madrob_console.common.files import Hold
from madrob_console.referee.journal import HOLD_FILE, Entry, Journal, Origin
from recorder.bag import METADATA_FILE, evidence_file_name
from recorder.mcap_writer import McapFile
from recorder.reader import read_bag
from recorder.recovery import recover
from recorder.survey import put_listing
from tests.madrob_console.recorded_runs import appealed, completed, copy_run, final, without_digests
from tests.recorder.samples import add_evidence, strings, talk
from tests.recorder.test_recovery import Killed, killed_after

FRAMES = strings(["a picture", "another"])
DAY = 86400.0
NOW = 1_800_000_000.0


def place(root: Path, source: Path, age: float, *, number: int = 1, practice: bool = False) -> Path:
    """A run of some days ago, as official or practice run."""
    stem = source.name.replace("_run_001_", f"_run_{number:03d}_")[: -len("YYYYMMDD_HHMMSS")]
    started = NOW - age * DAY
    name = stem + time.strftime("%Y%m%d_%H%M%S", time.localtime(started))
    folder = root / "practice" / name if practice else root / name
    shutil.copytree(source, folder)
    change(
        folder,
        run_number=number,
        start=started,
        source="ros",
        run_id="",
        setup=stored_setup(folder) | {"practice": practice, "team": "Delft"},
    )
    return folder


def stored_setup(folder: Path) -> dict[str, Any]:
    setup: dict[str, Any] = json.loads((folder / RESULT_FILE).read_text())["setup"]
    return setup


def change(folder: Path, **values: Any) -> None:  # noqa: ANN401  JSON
    path = folder / RESULT_FILE
    document = json.loads(path.read_text())
    path.write_text(json.dumps(document | values))
    without_digests(folder)


def put_evidence(folder: Path, *numbers: int) -> Path:
    """Evidence of a run, listed as the recorder leaves it."""
    for number in numbers or (0,):
        add_evidence(folder, FRAMES, number)
    list_files(folder)
    return folder


def list_files(folder: Path) -> None:
    fd = os.open(folder, os.O_DIRECTORY)
    assert put_listing(fd) is not None
    os.close(fd)


def look(root: Path, limits: TidyLimits = TidyLimits(), free: float = 0.0) -> dict[str, str]:  # noqa: B008
    """By folder why the evidence stays."""
    return {one.run.folder: one.kept for one in evidence_at(root, limits, NOW, free)}


def the_one(root: Path) -> RunEvidence:
    return next(one for one in evidence_at(root, TidyLimits(), NOW, 0.0) if not one.kept)


def evidence_left(folder: Path) -> list[str]:
    return [item.name for item in folder.iterdir() if "_evidence_" in item.name]


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def open_by_others(folder: Path) -> int:
    with Reader(folder) as reader:
        return sum(1 for _ in reader.messages())


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Holds the last official and the last practice run, both with evidence."""
    put_evidence(place(tmp_path, completed(), 0.5, number=9))
    put_evidence(place(tmp_path, completed(), 0.2, number=9, practice=True))
    return tmp_path


@pytest.fixture
def run(root: Path) -> Path:
    """An old final run with evidence and pictures."""
    folder = put_evidence(place(root, final(), 30), 0, 1)
    (folder / "pictures").mkdir()
    (folder / "pictures" / "door_opens.jpg").write_bytes(b"picture")
    return folder


def test_an_old_final_run_may_go_and_the_last_ones_stay_with_a_reason(
    root: Path, run: Path
) -> None:
    assert list(look(root).values()) == [
        "",
        "its result is not final",
        "it is the last practice run",
    ]
    for other in (*root.glob("subject_*_009_*"), *root.glob("practice/subject_*")):
        shutil.rmtree(other)
    assert look(root) == {run.name: "it is the last run"}
    put_evidence(place(root, final(), 20, practice=True))
    assert list(look(root).values()) == ["it is the last run", "it is the last practice run"]


def test_practice_is_signed_by_nobody_and_may_go_all_the_same(root: Path) -> None:
    old = put_evidence(place(root, completed(), 30, practice=True))
    assert look(root)[f"practice/{old.name}"] == ""
    remove_evidence(the_one(root), NOW)
    assert not list(old.glob("*_evidence_*"))
    assert [run.problem for run in History(root).refresh()] == [None, None, None]


def test_evidence_of_a_signed_run_stays_while_a_protest_may_come(root: Path, run: Path) -> None:
    signed = read_run_journal(run).run.signed
    assert signed is not None
    over = signed + 1800.0
    (found,) = (
        one
        for one in evidence_at(root, TidyLimits(older_than=-1e9), over - 60.0, 0.0)
        if one.folder == run
    )
    assert found.kept.startswith("a protest is possible until ")
    assert found.kept.endswith(time.strftime("%H:%M", time.localtime(over)))
    one = the_one(root)
    with pytest.raises(MadrobError, match="a protest is possible until"):
        remove_evidence(one, over - 60.0)
    assert evidence_left(run)
    remove_evidence(one, over + 1.0)
    assert not evidence_left(run)


def protested(root: Path) -> None:
    put_evidence(place(root, appealed(), 30))


def cut_off(root: Path) -> None:
    (put_evidence(place(root, final(), 30)) / RESULT_FILE).unlink()


def unsigned(root: Path) -> None:
    put_evidence(place(root, completed(), 30))


def out_of_date(root: Path) -> None:
    change(put_evidence(place(root, final(), 30)), closure=None)


def damaged(root: Path) -> None:
    (put_evidence(place(root, final(), 30)) / RESULT_FILE).write_text("{")


def without_a_journal(root: Path) -> None:
    (put_evidence(place(root, final(), 30)) / JOURNAL_FILE).unlink()


@pytest.mark.parametrize(
    ("made", "why"),
    [
        (protested, "it was protested"),
        (cut_off, "it has no result"),
        (unsigned, "its result is not final"),
        (out_of_date, "its result cannot be used: result.json is not what the journal says"),
        (damaged, "its result cannot be used: "),
        (without_a_journal, "it has no journal"),
    ],
)
def test_what_may_be_wanted_stays_with_its_reason(
    root: Path, made: Callable[[Path], None], why: str
) -> None:
    made(root)
    assert next(iter(look(root).values())).startswith(why)


def test_a_run_on_which_somebody_works_stays(root: Path, run: Path) -> None:
    with Hold(run / HOLD_FILE):
        assert look(root)[run.name] == "a console works on it"
        assert run_going_on(root) is None
        (run / RESULT_FILE).unlink()
        assert look(root)[run.name] == "the run goes on"
        assert run_going_on(root) == run.name


def test_evidence_that_is_still_written_stays(root: Path, run: Path) -> None:
    fd = os.open(run, os.O_DIRECTORY)
    file = McapFile(fd, evidence_file_name(run.name, 2))
    file.start([talk()], {})
    assert look(root)[run.name] == "it is still recorded"
    file.close()
    assert look(root)[run.name] == ""


def test_the_newest_runs_of_each_kind_stay_and_the_young_ones(root: Path) -> None:
    days = {number: float(10 * number) for number in range(1, 6)}
    for number, age in days.items():
        put_evidence(place(root, final(), age, number=number))
        put_evidence(place(root, final(), age + 1, number=number, practice=True))
    kept = look(root, TidyLimits(keep_runs=3))
    gone = [name.partition("_run_")[2][:3] for name, why in kept.items() if not why]
    assert gone == ["005", "005", "004", "004", "003", "003"]
    assert [why for why in kept.values() if why][:4] == [
        *("it is one of the last 3 practice runs", "it is one of the last 3 runs") * 2
    ]
    old = list(look(root, TidyLimits(older_than=25 * DAY)).values())
    assert (old.count("it is not old enough"), old.count("")) == (4, 6)


def test_no_more_goes_than_it_takes_and_the_oldest_first(root: Path) -> None:
    runs = [put_evidence(place(root, final(), 50 - n, number=n)) for n in range(1, 5)]
    sizes = [one.size for one in evidence_at(root, TidyLimits(), NOW, 0.0)][:4]
    wanted = TidyLimits(until_free=1000.0 + sizes[0] + 1)
    kept = look(root, wanted, free=1000.0)
    assert [kept[run.name] for run in runs] == ["", "", *["there is room enough"] * 2]
    assert not any(why == "" for why in look(root, TidyLimits(until_free=5.0), free=10.0).values())


def test_what_is_scored_stays_to_the_byte_and_the_journal_says_what_went(
    root: Path, run: Path
) -> None:
    before = files_of(run)
    names = sorted(path.name for path in run.glob("*_evidence_*"))
    size = sum((run / name).stat().st_size for name in names)
    remove_evidence(the_one(root), NOW)
    after = files_of(run)
    changed = {JOURNAL_FILE, "metadata.yaml"}
    assert {*before} - {*after} == {*names}
    assert {name for name in after if after[name] != before[name]} == changed
    assert after[JOURNAL_FILE].startswith(before[JOURNAL_FILE])
    known = read_run_journal(run)
    entry = known.entries[-1]
    assert (entry.what, entry.origin, entry.time) == ("evidence removed", Origin.SYSTEM, NOW)
    assert entry.details == {"files": names, "bytes": size}
    (told,) = known.run.removed_evidence
    assert (told.files, told.bytes) == (2, size)
    assert run.name not in look(root)
    assert open_by_others(run) == open_by_others(final())


@pytest.mark.parametrize(("source", "place"), [(final, "."), (completed, "practice")])
def test_lists_and_checks_find_the_run_as_it_was(
    root: Path, source: Callable[[], Path], place: str
) -> None:
    run = root / place / source().name
    shutil.copytree(source(), run)
    put_evidence(run)
    folder = str(run.relative_to(root))
    before = next(one for one in History(root).refresh() if one.folder == folder)
    remove_evidence(the_one(root), NOW)
    after = next(one for one in History(root).refresh() if one.folder == folder)
    assert not evidence_left(run)
    assert after == before
    assert check_run(RunPath(run)).found == ()
    assert repair(run) is None


def test_what_repairs_left_of_evidence_goes_too(root: Path, run: Path) -> None:
    file = run / evidence_file_name(run.name, 1)
    file.with_name(f"{file.name}.torn").write_bytes(file.read_bytes()[:-50])
    assert any(name.endswith(".torn") for name in the_one(root).files)
    remove_evidence(the_one(root), NOW)
    assert not list(run.glob("*evidence*"))


def test_links_and_pipes_are_left_alone(root: Path, run: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere.mcap"
    elsewhere.write_bytes(b"somebody's")
    (run / evidence_file_name(run.name, 7)).symlink_to(elsewhere)
    os.mkfifo(run / evidence_file_name(run.name, 8))
    remove_evidence(the_one(root), NOW)
    assert elsewhere.read_bytes() == b"somebody's"
    assert len(list(run.glob("*_evidence_*"))) == 2


def of_another_process(run: Path) -> None:
    """What was left half written has the number of whoever wrote it."""
    for part in run.glob("metadata.yaml.*.part"):
        part.rename(run / "metadata.yaml.1.part")


def test_a_kill_at_any_step_leaves_a_bag_that_others_open_and_the_score(root: Path) -> None:
    scored = open_by_others(final())
    for steps in range(100):
        for old in root.glob("*_run_001_*"):
            shutil.rmtree(old)
        run = put_evidence(place(root, final(), 30), 0, 1)
        before = files_of(run)
        one = the_one(root)
        try:
            with killed_after(steps):
                remove_evidence(one, NOW)
        except Killed:
            assert open_by_others(run) > 0
            kept = {JOURNAL_FILE, "metadata.yaml"}
            after = files_of(run)
            same = {name: after.get(name) for name in before if "_evidence_" not in name}
            assert {n: c for n, c in same.items() if n not in kept} == {
                n: c for n, c in before.items() if "_evidence_" not in n and n not in kept
            }
            of_another_process(run)
            if list(run.glob("*_evidence_*")):
                remove_evidence(the_one(root), NOW + 1)
            assert not [*run.glob("*_evidence_*"), *run.glob("*.part")]
            assert len(read_run_journal(run).run.removed_evidence) == 1
            assert open_by_others(run) == scored
        else:
            break
    assert 8 < steps < 99


def test_a_disk_that_refuses_from_any_step_on_is_named_and_the_run_is_whole(root: Path) -> None:
    said: list[str] = []
    for steps in range(100):
        for old in root.glob("*_run_001_*"):
            shutil.rmtree(old)
        run = put_evidence(place(root, final(), 30))
        one, full = the_one(root), OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        try:
            with killed_after(steps, full):
                remove_evidence(one, NOW)
        except MadrobError as error:
            said.append(str(error).removeprefix(f"{run}: "))
        else:
            break
        assert open_by_others(run) > 0
        assert look(root).get(run.name, "") == ""
        of_another_process(run)
        if list(run.glob("*_evidence_*")):
            remove_evidence(the_one(root), NOW + 1)
        assert not list(run.glob("*.part"))
    assert 8 < steps < 99
    assert sum("No space left on device" in words for words in said) >= steps - 2
    assert not any("\n" in words or str(root) in words for words in said)


@pytest.mark.parametrize("call", ["fsync", "rename"])
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO])
def test_a_metadata_file_that_the_disk_refuses_leaves_nothing_half_written(
    root: Path, run: Path, call: str, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuses(*_what: object, **_more: object) -> None:
        if list(run.glob("metadata.yaml.*.part")):
            raise OSError(number, os.strerror(number))

    before = (run / "metadata.yaml").read_bytes()
    with monkeypatch.context() as patched:
        patched.setattr(os, call, refuses)
        with pytest.raises(MadrobError, match=os.strerror(number)):
            remove_evidence(the_one(root), NOW)
    assert not list(run.glob("*.part"))
    assert (run / "metadata.yaml").read_bytes() == before
    assert len(evidence_left(run)) == 2


def test_a_run_that_was_opened_meanwhile_keeps_its_evidence(root: Path, run: Path) -> None:
    one = the_one(root)
    before = files_of(run)
    with (
        Hold(run / HOLD_FILE),
        pytest.raises(MadrobError, match="a console works on this run"),
    ):
        remove_evidence(one, NOW)
    assert files_of(run) == before
    journal = Journal()
    journal.reopen(run / JOURNAL_FILE)
    journal.append([Entry(NOW, Origin.REFEREE, "re-issue", "R", "video", {"reason": "video"})])
    journal.close()
    with pytest.raises(MadrobError, match="not final any more: nothing of it was removed"):
        remove_evidence(one, NOW)
    assert len(list(run.glob("*_evidence_*"))) == 2


def test_a_bag_whose_recording_is_torn_keeps_what_its_metadata_lists(root: Path, run: Path) -> None:
    recording = next(run.glob("*_0.mcap"))
    recording.write_bytes(recording.read_bytes()[:-50])
    with pytest.raises(MadrobError, match="`madrob recover` repairs it: nothing of its evidence"):
        remove_evidence(the_one(root), NOW)
    assert len(list(run.glob("*_evidence_*"))) == 2
    assert not read_run_journal(run).run.removed_evidence
    recover(run)
    remove_evidence(the_one(root), NOW)
    assert not list(run.glob("*_evidence_*"))


@pytest.fixture
def recorded_run(tmp_path: Path) -> Path:
    return copy_run(tmp_path, 1)


def torn(recorded_run: Path) -> Path:
    file = add_evidence(recorded_run, FRAMES)
    file.write_bytes(file.read_bytes()[:-50])
    return file


def contents(recorded_run: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in recorded_run.iterdir() if path.is_file()}


def test_an_engine_that_starts_repairs_evidence_that_was_cut_off(recorded_run: Path) -> None:
    before = contents(recorded_run)
    file = torn(recorded_run)
    assert list(repair_all(recorded_run.parent)) == []
    bag = read_bag(recorded_run, evidence=True)
    assert list(bag.messages()) == FRAMES
    assert file.name in (recorded_run / "metadata.yaml").read_text()
    after = contents(recorded_run)
    told = (METADATA_FILE, JOURNAL_FILE, RESULT_FILE, "report.html")
    assert {name for name in before if after[name] != before[name]} <= set(told)
    stored, now = (json.loads(files[RESULT_FILE]) for files in (before, after))
    assert {key for key in stored if now[key] != stored[key]} <= {"evidence", "files", "journal"}
    account = now["evidence"]
    assert [topic["messages"] for topic in account["topics"]] == [len(FRAMES)]
    assert "what was lost is not known" in account["problems"][0]
    assert account["file_bytes"] == file.stat().st_size
    assert list(repair_all(recorded_run.parent)) == []
    assert contents(recorded_run) == after


def test_it_does_so_beside_a_run_that_was_cut_off_itself(recorded_run: Path) -> None:
    (recorded_run / RESULT_FILE).unlink()
    recording = next(recorded_run.glob("*_0.mcap"))
    recording.write_bytes(recording.read_bytes()[:-100])
    torn(recorded_run)
    before = recording.read_bytes()
    assert list(repair_all(recorded_run.parent)) == []
    assert list(read_bag(recorded_run, evidence=True).messages()) == FRAMES
    assert recording.read_bytes() == before


def test_evidence_that_is_listed_is_not_opened(recorded_run: Path) -> None:
    torn(recorded_run)
    assert list(repair_all(recorded_run.parent)) == []
    file = next(recorded_run.glob("*_evidence_0.mcap"))
    garbage = b"whatever it is" * 100
    file.write_bytes(garbage)
    assert list(repair_all(recorded_run.parent)) == []
    assert file.read_bytes() == garbage


def test_a_run_that_goes_on_is_left_alone(recorded_run: Path) -> None:
    before = torn(recorded_run).read_bytes()
    assert (recorded_run / JOURNAL_FILE).is_file()
    with Hold(recorded_run / HOLD_FILE):
        assert list(repair_all(recorded_run.parent)) == []
    assert next(recorded_run.glob("*_evidence_0.mcap")).read_bytes() == before


_opened: list[str] = []
_watching = [False]


def _hear(event: str, arguments: tuple[object, ...]) -> None:
    if _watching[0] and event == "open":
        _opened.append(str(arguments[0]))


sys.addaudithook(_hear)


@contextmanager
def opened_files() -> Iterator[list[str]]:
    """Every path that is opened meanwhile."""
    _opened.clear()
    _watching[0] = True
    try:
        yield _opened
    finally:
        _watching[0] = False


@pytest.fixture
def results(recorded_run: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A results folder whose run has evidence that is garbage, and a pipe, on which reads hang."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(recorded_run.parent / "config"))
    recording = next(recorded_run.glob("*_0.mcap")).name.removesuffix("_0.mcap")
    (recorded_run / evidence_file_name(recording, 0)).write_bytes(b"garbage" * 1000)
    os.mkfifo(recorded_run / evidence_file_name(recording, 1))
    return recorded_run.parent


COMMANDS = {
    "score": ["score", "--jobs", "1", "RESULTS"],
    "check": ["score", "--check", "--jobs", "1", "RESULTS"],
    "runs": ["table", "runs", "RESULTS"],
    "steps": ["table", "steps", "RESULTS"],
    "samples": ["table", "samples", "RESULTS", "--output", "NEW"],
    "standings": ["standings", "--practice", "RESULTS"],
    "publish": ["publish", "--practice", "NEW", "RESULTS"],
}


@pytest.mark.parametrize("name", COMMANDS)
def test_no_command_that_lists_or_scores_opens_evidence(
    results: Path, tmp_path_factory: pytest.TempPathFactory, name: str
) -> None:
    new = tmp_path_factory.mktemp("new") / "site"
    places = {"RESULTS": str(results), "NEW": str(new)}
    with opened_files() as opened:
        assert main([places.get(word, word) for word in COMMANDS[name]]) == 0
    assert opened
    assert not [path for path in opened if "_evidence_" in path]


def test_a_report_is_made_beside_evidence_that_is_no_recording(results: Path) -> None:
    assert main(["report", str(results)]) == 0
    (page,) = results.glob("*/report.html")
    assert "capability level" in page.read_text()


def test_the_history_neither_opens_evidence_nor_differs_by_it(results: Path) -> None:
    (recorded_run,) = History(results).refresh()
    evidence = list(results.glob("*/*_evidence_*"))
    (results / INDEX_FILE).unlink()
    with opened_files() as opened:
        assert History(results).refresh() == (recorded_run,)
    assert opened
    assert not [path for path in opened if "_evidence_" in path]
    for path in evidence:
        path.unlink()
    assert History(results).refresh() == (recorded_run,)
