"""Score what lies on disk: bags, run folders, EUROBENCH folders.

A bag gives the result that the console showed: same decoder, same assessment, same order.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import msgspec

from madrob_console.engine.record import RECORD_NAME, RunRecord
from madrob_console.engine.results import ending_of
from madrob_console.errors import MadrobError
from madrob_console.referee.journal import Entry, read_journal
from madrob_console.referee.rebuild import rebuild
from madrob_console.referee.run import Run
from madrob_console.runs import JOURNAL_FILE, RESULT_FILE
from madrob_console.testbeds.messages import (
    REFEREE_EVENT_TOPIC,
    Decoder,
    MessageError,
    MessageTypes,
    decode_text,
)
from recorder.errors import RecorderError
from recorder.reader import Bag, read_bag
from scoring.errors import ScoringError
from scoring.eurobench import read_eurobench
from scoring.evaluate import Assessment, Rows, with_remarks
from scoring.published import evaluate_published
from scoring.result import Result
from scoring.rulesets import PROTOCOL, RulesetName, ruleset


@dataclass(frozen=True, slots=True, eq=False)
class RecordedRun:
    """What a bag and its journal say of a run, before scoring.

    Attributes:
        bag: the recording.
        record: what was set.
        entries: the journal.
        run: the state after all of it.
        remarks: what could not be read, in words.
    """

    bag: Bag
    record: RunRecord
    entries: tuple[Entry, ...]
    run: Run
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class OpenedRun:
    """A run of the results folder, read back: where it stands, and its data."""

    folder: Path
    recorded: RecordedRun
    assessment: Assessment


class _StoredQuality(msgspec.Struct):
    remarks: list[str]


class _Stored(msgspec.Struct):
    quality: _StoredQuality


@dataclass(frozen=True, slots=True, eq=False)
class ScoredPath:
    """The result of one run on disk, and the data behind it."""

    path: Path
    result: Result
    rows: Rows


def score_path(path: Path, rules: RulesetName | None = None) -> tuple[ScoredPath, ...]:
    """Score a bag, a run folder or a folder of EUROBENCH files (which may hold several runs).

    Args:
        path: what to score.
        rules: the ruleset; that of the run if not given, `protocol` for EUROBENCH files.

    Raises:
        MadrobError: it cannot be scored; the message names path and remedy.
    """
    try:
        if path.is_dir() and not _holds_bag(path) and any(path.glob("*_event.csv")):
            chosen = ruleset(rules) if rules else PROTOCOL
            return tuple(
                ScoredPath(path / run.prefix, *evaluate_published(run, chosen))
                for run in read_eurobench(path)
            )
        return (_score_bag(path, rules),)
    except (RecorderError, ScoringError) as error:
        raise MadrobError(str(error)) from None
    except OSError as error:
        raise MadrobError(
            f"{path}: cannot be read ({error.strerror}); check the path and its permissions"
        ) from None


def _holds_bag(folder: Path) -> bool:
    return (folder / "metadata.yaml").exists() or any(folder.glob("*.mcap"))


def read_recorded_run(path: Path) -> RecordedRun:
    """Read what a bag or a run folder says of its run.

    The journal file of a run folder comes first, it also tells what the referee said after the
    recording; without it the journal in the bag is used.

    Raises:
        MadrobError: no run is recorded there, or it is damaged.
        RecorderError: there is no bag.
    """
    bag = read_bag(path)
    metadata = bag.records.get(RECORD_NAME)
    if metadata is None:
        raise MadrobError(f"{path}: a bag without a MADROB run; only madrob's bags can be scored")
    record = RunRecord.from_metadata(dict(metadata))
    entries, remarks = _journal_file(path)
    if not entries:
        entries = tuple(_journal_in(bag))
    run = rebuild(entries, record.handle_zero)
    if run.start is None:
        raise MadrobError(f"{path}: the run was never started, there is nothing to score")
    return RecordedRun(bag, record, entries, run, remarks)


def _journal_file(path: Path) -> tuple[tuple[Entry, ...], tuple[str, ...]]:
    journal = path / JOURNAL_FILE
    try:
        return read_journal(journal)
    except (FileNotFoundError, NotADirectoryError):
        return (), ()
    except OSError as error:
        return (), (f"{journal.name} cannot be read ({error.strerror}): the bag's journal is used",)


def _journal_in(bag: Bag) -> Iterable[Entry]:
    types = MessageTypes()
    for message in bag.messages():
        if message.topic == REFEREE_EVENT_TOPIC:
            yield Entry.from_json(decode_text(types, message.data))


def assess(recorded: RecordedRun, rules: RulesetName | None = None) -> Assessment:
    """Follow a recorded run once more, to the end of its bag.

    Raises:
        RecorderError: the bag cannot be read.
    """
    run, record, bag = recorded.run, recorded.record, recorded.bag
    assert run.start is not None
    assessment = record.assessment(run.start, rules)
    types = MessageTypes()
    for topic in bag.topics():
        if not types.knows(topic.type):
            types.register(topic.type, topic.definition)
    decoder = Decoder(record.mappings, types)
    for message in bag.messages():
        try:
            sample = decoder.decode(message)
        except MessageError as error:
            assessment.report_problem(str(error))
            continue
        if sample is not None:
            assessment.feed(sample)
    for remark in (*recorded.remarks, *([bag.problem] if bag.problem else [])):
        assessment.report_problem(remark)
    return assessment


def open_run(folder: Path) -> OpenedRun:
    """Read a run of the results folder, to look at it and to go on with it.

    What its stored result says of the data and the bag cannot tell (messages dropped on the way)
    is kept.

    Raises:
        MadrobError: it cannot be read; the message names path and remedy.
    """
    try:
        recorded = read_recorded_run(folder)
        assessment = assess(recorded)
    except (RecorderError, ScoringError) as error:
        raise MadrobError(str(error)) from None
    known = {*assessment.quality().remarks, *recorded.run.remarks()}
    for remark in _stored_remarks(folder):
        if remark not in known:
            assessment.report_problem(remark)
    return OpenedRun(folder, recorded, assessment)


def _stored_remarks(folder: Path) -> list[str]:
    try:
        stored = msgspec.json.decode((folder / RESULT_FILE).read_bytes(), type=_Stored)
    except (OSError, msgspec.DecodeError, UnicodeDecodeError):
        return []  # none was written, or it is damaged: it is made again
    return stored.quality.remarks


def _score_bag(path: Path, rules: RulesetName | None) -> ScoredPath:
    recorded = read_recorded_run(path)
    run = recorded.run
    result, rows = assess(recorded, rules).result(ending_of(run), run.rulings)
    return ScoredPath(path, with_remarks(result, run.remarks()), rows)
