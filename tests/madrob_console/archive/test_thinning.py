"""The evidence beside what is scored: repaired where it was cut off, thinned, opened by no list."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from madrob_console.archive.check import check_run
from madrob_console.archive.evidence_removal import (
    RunEvidence,
    TidyLimits,
    evidence_at,
    remove_evidence,
    run_going_on,
)
from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.archive.history import History
from madrob_console.archive.repair import repair
from madrob_console.archive.run_journal import read_run_journal
from madrob_console.archive.run_paths import RunPath
from madrob_console.cli.repairing import repair_all
from madrob_console.common.errors import MadrobError
from madrob_console.common.file_locks import Hold
from madrob_console.referee.journal import HOLD_FILE, Entry, Origin
from recorder.bag import METADATA_FILE, evidence_file_name
from recorder.mcap_file import McapFile
from recorder.reader import Bag
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.recorded_runs import (
    aborted,
    appealed,
    completed,
    copy_run,
    final,
    list_files,
    without_digests,
)
from tests.recorder.samples import (
    Killed,
    add_evidence,
    by_rosbags,
    killed_after,
    opened,
    strings,
    talk,
)

FRAMES = strings(["a picture", "another"])
DAY = 86400.0
NOW = 1_800_000_000.0


def place(root: Path, source: Path, age: float, *, number: int = 1, practice: bool = False) -> Path:
    """A run of some days ago with evidence, as official or practice run."""
    stem = source.name.replace("_run_001_", f"_run_{number:03d}_")[: -len("YYYYMMDD_HHMMSS")]
    started = NOW - age * DAY
    name = stem + time.strftime("%Y%m%d_%H%M%S", time.localtime(started))
    folder = shutil.copytree(source, root / ("practice" if practice else "") / name)
    setup = json.loads((folder / RESULT_FILE).read_text())["setup"]
    own = setup | {"practice": practice, "team": "Delft"}
    change(folder, run_number=number, start=started, source="ros", run_id="", setup=own)
    return put_evidence(folder, 0)


def change(folder: Path, **values: object) -> None:
    path = folder / RESULT_FILE
    path.write_text(json.dumps(json.loads(path.read_text()) | values))
    without_digests(folder)


def put_evidence(folder: Path, number: int) -> Path:
    """Evidence of a run, listed as the recorder leaves it."""
    add_evidence(folder, FRAMES, number)
    list_files(folder)
    return folder


def look(root: Path, limits: TidyLimits = TidyLimits(), free: float = 0.0) -> dict[str, str]:  # noqa: B008
    """By folder why the evidence stays."""
    return {one.run.folder: one.why_kept for one in evidence_at(root, limits, NOW, free)}


def the_one(root: Path) -> RunEvidence:
    return next(one for one in evidence_at(root, TidyLimits(), NOW, 0.0) if not one.why_kept)


def evidence_left(folder: Path) -> list[Path]:
    return sorted(folder.glob("*_evidence_*"))


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def open_by_others(folder: Path) -> int:
    """How many messages a reader of others finds; what it has read once is not read again."""
    bag = tuple(sorted((p.name, p.read_bytes()) for p in folder.glob("*[ml]") if p.is_file()))
    if bag not in _READ:
        _READ[bag] = len(by_rosbags(folder))
    return _READ[bag]


_READ: dict[tuple[tuple[str, bytes], ...], int] = {}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Holds the last official and the last practice run, both with evidence."""
    place(tmp_path, completed(), 0.5, number=9)
    place(tmp_path, completed(), 0.2, number=9, practice=True)
    return tmp_path


@pytest.fixture
def run(root: Path) -> Path:
    """An old final run with evidence."""
    return put_evidence(place(root, final(), 30), 1)


# ---------------------------------------------------------------- what may go


def without(name: str) -> Callable[[Path], object]:
    return lambda run: (run / name).unlink()


STAYS: dict[str, tuple[Callable[[], Path], Callable[[Path], object], str]] = {
    "final": (final, lambda _: None, ""),
    "protested": (appealed, lambda _: None, "it was protested"),
    "cut off": (final, without(RESULT_FILE), "it has no result"),
    "unsigned": (completed, lambda _: None, "its result is not final"),
    "out of date": (
        final,
        lambda run: change(run, closure=None),
        "its result cannot be used: result.json is not what the journal says",
    ),
    "damaged": (
        final,
        lambda run: (run / RESULT_FILE).write_text("{"),
        "its result cannot be used: ",
    ),
    "without a journal": (final, without(JOURNAL_FILE), "it has no journal"),
}


@pytest.mark.parametrize("case", STAYS)
def test_what_may_be_wanted_stays_with_its_reason(root: Path, case: str) -> None:
    source, spoil, why = STAYS[case]
    spoil(place(root, source(), 30))
    first, *others = look(root).values()
    assert (first.startswith(why), bool(first)) == (True, bool(why))
    assert others == ["its result is not final", "it is the last practice run"]


def test_the_newest_runs_of_each_kind_stay_and_the_young_ones(tmp_path: Path) -> None:
    for number in range(1, 6):
        place(tmp_path, final(), 10.0 * number, number=number)
        place(tmp_path, completed(), 10.0 * number + 1, number=number, practice=True)
    last = ["it is the last practice run", "it is the last run"]
    assert list(look(tmp_path).values())[-2:] == last
    kept = look(tmp_path, TidyLimits(keep_runs=3))
    gone = [name.partition("_run_")[2][:3] for name, why in kept.items() if not why]
    assert gone == ["005", "005", "004", "004"]  # nobody signs practice
    of_three = "it is one of the last 3 practice runs", "it is one of the last 3 runs"
    assert [why for why in kept.values() if why] == [*of_three * 2, *last]
    old = list(look(tmp_path, TidyLimits(older_than=25 * DAY)).values())
    assert (old.count("it is not old enough"), old.count("")) == (2, 6)


def test_no_more_goes_than_it_takes_and_the_oldest_first(root: Path) -> None:
    runs = [place(root, final(), 50 - n, number=n) for n in range(1, 5)]
    sizes = [one.size for one in evidence_at(root, TidyLimits(), NOW, 0.0)][:4]
    kept = look(root, TidyLimits(until_free=1000.0 + sizes[0] + 1), free=1000.0)
    assert [kept[run.name] for run in runs] == ["", "", *["there is room enough"] * 2]
    assert all(look(root, TidyLimits(until_free=5.0), free=10.0).values())


def test_evidence_of_a_signed_run_stays_while_a_protest_may_come(root: Path, run: Path) -> None:
    signed = read_run_journal(run).run.signed
    assert signed is not None
    over = signed + 1800.0
    young = evidence_at(root, TidyLimits(older_than=-1e9), over - 60.0, 0.0)
    (kept,) = (one.why_kept for one in young if one.folder == run)
    until = time.strftime("%H:%M", time.localtime(over))
    assert re.fullmatch(f"a protest is possible until .*{until}", kept)
    one = the_one(root)
    with pytest.raises(MadrobError, match="a protest is possible until"):
        remove_evidence(one, over - 60.0)
    assert evidence_left(run)
    remove_evidence(one, over + 1.0)
    assert not evidence_left(run)


def test_a_run_on_which_somebody_or_something_works_stays(root: Path, run: Path) -> None:
    with opened(run) as fd:
        file = McapFile(fd, evidence_file_name(run.name, 2))
    file.start([talk()], {})
    assert look(root)[run.name] == "it is still recorded"
    file.close()
    one, before = the_one(root), files_of(run)
    with Hold(run / HOLD_FILE):
        assert look(root)[run.name] == "a console works on it"
        assert run_going_on(root) is None
        with pytest.raises(MadrobError, match="a console works on this run"):
            remove_evidence(one, NOW)
    assert files_of(run) == before
    line = Entry(NOW, Origin.REFEREE, "re-issue", "R", "video", {"reason": "video"}).to_json()
    with (run / JOURNAL_FILE).open("a") as journal:
        journal.write(f"{line}\n")
    with pytest.raises(MadrobError, match="not final any more: nothing of it was removed"):
        remove_evidence(one, NOW)
    assert evidence_left(run)
    (run / RESULT_FILE).unlink()
    with Hold(run / HOLD_FILE):
        assert look(root)[run.name] == "the run goes on"
        assert run_going_on(root) == run.name


# ---------------------------------------------------------------- what goes


def test_what_is_scored_stays_to_the_byte_and_the_journal_says_what_went(
    root: Path, run: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    (run / "pictures").mkdir()
    (run / "pictures" / "door_opens.jpg").write_bytes(b"picture")
    part = run / evidence_file_name(run.name, 1)
    part.with_name(f"{part.name}.torn").write_bytes(part.read_bytes()[:-50])  # as a repair leaves
    names = [path.name for path in evidence_left(run)]
    size = sum(path.stat().st_size for path in evidence_left(run))
    elsewhere = tmp_path_factory.mktemp("elsewhere") / "somebody_s.mcap"
    elsewhere.write_bytes(b"somebody's")
    (run / evidence_file_name(run.name, 7)).symlink_to(elsewhere)
    os.mkfifo(run / evidence_file_name(run.name, 8))
    before = files_of(run)
    remove_evidence(the_one(root), NOW)
    after = files_of(run)
    assert elsewhere.read_bytes() == b"somebody's"
    assert len(evidence_left(run)) == 2  # the link and the pipe
    assert {*before} - {*after} == {*names}
    assert {n for n in after if after[n] != before[n]} == {JOURNAL_FILE, METADATA_FILE}
    assert after[JOURNAL_FILE].startswith(before[JOURNAL_FILE])
    journal = read_run_journal(run)
    details = {"files": names, "bytes": size}
    removed = Entry(NOW, Origin.SYSTEM, "evidence removed", details=details)
    assert journal.entries[-1] == removed
    assert [(one.files, one.bytes) for one in journal.run.removed_evidence] == [(3, size)]
    assert open_by_others(run) == open_by_others(final())


@pytest.mark.parametrize(("source", "place"), [(final, "."), (completed, "practice")])
def test_lists_and_checks_find_the_run_as_it_was(
    root: Path, source: Callable[[], Path], place: str
) -> None:
    run = shutil.copytree(source(), root / place / source().name)
    put_evidence(run, 0)
    before = History(root).refresh()
    assert not any(one.problem for one in before)
    remove_evidence(the_one(root), NOW)
    assert not evidence_left(run)
    assert History(root).refresh() == before
    assert check_run(RunPath(run)).differences == ()
    assert repair(run) is None


FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("error", [None, FULL], ids=["killed", "refused"])
def test_a_kill_or_a_refusal_at_any_step_leaves_a_bag_that_others_open_and_the_score(
    root: Path, tmp_path_factory: pytest.TempPathFactory, error: OSError | None
) -> None:
    """Of a short practice run, which nobody signs."""
    scored, said = open_by_others(aborted()), list[str]()
    aside = place(tmp_path_factory.mktemp("aside"), aborted(), 30, practice=True)
    put_evidence(aside, 1)
    run = root / "practice" / aside.name
    for steps in range(100):
        shutil.rmtree(run, ignore_errors=True)
        shutil.copytree(aside, run)
        before, one = files_of(run), the_one(root)
        try:
            with killed_after(steps, error):
                remove_evidence(one, NOW)
            break
        except Killed:
            assert error is None
        except MadrobError as refused:
            said.append(str(refused).removeprefix(f"{run}: "))
        assert open_by_others(run) > 0
        after, changing = files_of(run), {JOURNAL_FILE, METADATA_FILE}
        stay = {name for name in before if "_evidence_" not in name} - changing
        assert {name: after.get(name) for name in stay} == {name: before[name] for name in stay}
        for part in run.glob("metadata.yaml.*.part"):  # it has the number of whoever wrote it
            part.rename(run / "metadata.yaml.99999999.part")
        if evidence_left(run):
            remove_evidence(the_one(root), NOW + 1)
        assert not [*evidence_left(run), *run.glob("*.part")]
        assert len(read_run_journal(run).run.removed_evidence) == 1
        assert open_by_others(run) == scored
    assert 8 < steps < 99
    assert not any("\n" in words or str(root) in words for words in said)
    full = sum("No space left on device" in words for words in said)
    assert full >= (steps - 2 if error else 0)


# ---------------------------------------------------------------- what is repaired


@pytest.fixture
def torn(tmp_path: Path) -> Path:
    """A run whose evidence was cut off."""
    run = copy_run(tmp_path, 1)
    file = add_evidence(run, FRAMES)
    os.truncate(file, file.stat().st_size - 50)
    return run


def test_an_engine_that_starts_repairs_evidence_that_was_cut_off_once(torn: Path) -> None:
    before = files_of(torn)
    with Hold(torn / HOLD_FILE):  # the run goes on
        assert list(repair_all(torn.parent)) == []
    assert files_of(torn).items() >= before.items()
    assert list(repair_all(torn.parent)) == []
    assert list(Bag(torn, evidence=True).messages()) == FRAMES
    (file,) = evidence_left(torn)
    assert file.name in (torn / METADATA_FILE).read_text()
    after = files_of(torn)
    told = {METADATA_FILE, JOURNAL_FILE, RESULT_FILE, "report.html", file.name}
    assert {name for name in before if after[name] != before[name]} <= told
    stored, now = (json.loads(files[RESULT_FILE]) for files in (before, after))
    assert {key for key in stored if now[key] != stored[key]} <= {"evidence", "files", "journal"}
    account = now["evidence"]
    assert [topic["messages"] for topic in account["topics"]] == [len(FRAMES)]
    assert "what was lost is not known" in account["problems"][0]
    assert account["file_bytes"] == file.stat().st_size
    file.write_bytes(b"whatever it is" * 100)  # what is listed is not opened
    after[file.name] = file.read_bytes()
    for _ in range(2):
        assert list(repair_all(torn.parent)) == []
    assert files_of(torn) == after


def test_it_does_so_beside_a_run_that_was_cut_off_itself(torn: Path) -> None:
    (torn / RESULT_FILE).unlink()
    recording = next(torn.glob("*_0.mcap"))
    os.truncate(recording, recording.stat().st_size - 100)
    before = recording.read_bytes()
    assert list(repair_all(torn.parent)) == []
    assert list(Bag(torn, evidence=True).messages()) == FRAMES
    assert recording.read_bytes() == before


# ---------------------------------------------------------------- what is opened


_opened: list[str] = []
_watching: list[bool] = []
sys.addaudithook(
    lambda event, arguments: (
        _opened.append(str(arguments[0])) if _watching and event == "open" else None
    )
)

COMMANDS = (
    "score --jobs 1 {}",
    "score --check --jobs 1 {}",
    "table runs {}",
    "table steps {}",
    "table samples {} --output {new}",
    "standings --practice {}",
    "publish --practice {new} {}",
    "report {}",
    "history",
)


@pytest.mark.parametrize("line", COMMANDS)
def test_nothing_that_lists_or_scores_opens_evidence_or_differs_by_it(
    line: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, madrob: Madrob
) -> None:
    run = copy_run(tmp_path, 1)
    listed = History(tmp_path).refresh()
    (run / evidence_file_name(run.name, 0)).write_bytes(b"garbage" * 1000)
    os.mkfifo(run / evidence_file_name(run.name, 1))  # on which reads hang
    _opened.clear()
    _watching.append(True)
    try:
        if line == "history":
            assert History(tmp_path).refresh() == listed
        else:
            madrob(line.format(tmp_path, new=tmp_path_factory.mktemp("new") / "site"))
    finally:
        _watching.clear()
    assert _opened
    assert line == "report {}" or not [path for path in _opened if "_evidence_" in path]
    assert History(tmp_path).refresh() == listed
