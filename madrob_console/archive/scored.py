"""Scores runs: one that is over, and what lies on disk (bags, run folders, EUROBENCH folders).

A bag gives the result that the console showed: same decoder, same assessment, same order.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from itertools import takewhile
from pathlib import Path

from madrob_console.archive.folders import JOURNAL_FILE, RESULT_FILE
from madrob_console.archive.journal_agreement import disagreements
from madrob_console.archive.result_reader import (
    DamagedResultError,
    UnusableResultError,
    read_result,
    read_sound_result,
)
from madrob_console.archive.run_journal import read_run_journal
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.run_record import RECORD_NAME, RunLabel, RunRecord, record_from
from madrob_console.archive.unfinished_runs import is_held
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind, terminal_safe
from madrob_console.common.plain_files import Stamp, read_all, refusal, stamp_of
from madrob_console.messages.codec import REFEREE_EVENT_TOPIC, Decoder, decode_text
from madrob_console.messages.types import MessageError, standard_types, types_of
from madrob_console.referee.flags import Flag, flags, practice_flags
from madrob_console.referee.journal import LARGEST_JOURNAL, Entry, read_journal
from madrob_console.referee.rebuild import Change, mark_of, rebuild
from madrob_console.referee.run import Run
from recorder import RecorderError
from recorder.reader import Bag
from scoring.arrays import Evaluation
from scoring.assessment import Assessment
from scoring.eurobench import EurobenchRun, evaluate_published, read_run
from scoring.indicator_table import RulesetName
from scoring.kinematics import load_filters
from scoring.protocol import Outcome, ScoringError, Step
from scoring.result import Result
from scoring.rows import Rows
from scoring.run_info import numbers_of
from scoring.series import WholeSeries


@dataclass(frozen=True, slots=True, eq=False)
class RecordedRun:
    """A bag and its journal, before scoring.

    `record` is what was set, as corrected; `recorded_as` what was set when it was recorded; `run`
    the state after all of the journal; `remarks` what could not be read.
    """

    bag: Bag
    record: RunRecord
    recorded_as: RunRecord
    entries: tuple[Entry, ...]
    run: Run
    remarks: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class OpenedRun:
    """A run read back, with its samples; `out_of_date`: its result is missing or disagrees."""

    folder: Path
    recorded: RecordedRun
    assessment: Assessment
    out_of_date: bool


@dataclass(frozen=True, slots=True, eq=False)
class Scored:
    """A scored run; `rows` is the pre-processed data, cut to the run."""

    record: RunRecord
    run: Run
    result: Result
    rows: Rows

    @property
    def flags(self) -> tuple[Flag, ...]:
        result = self.result
        source = self.record.source
        return flags(self.run, result.steps, source, result.quality, result.indicators)

    @classmethod
    def of(
        cls, record: RunRecord, run: Run, assessment: Assessment, missing: Iterable[str] = ()
    ) -> Scored:
        """Score a run that is over; `assessment` has all of its samples but what is `missing`."""
        assessment.lost = tuple(missing) or assessment.lost
        remarks = [run.answer] if run.answer else []
        results = assessment.result(run.ending, run.rulings, remarks, run.answered_at)
        return cls(record, run, *results)


@dataclass(frozen=True, slots=True, eq=False)
class ScoredPath:
    """The result of one run on disk.

    `path` is the bag or folder; of a published run, the folder and how its files begin. `flags`
    of EUROBENCH's files only say whether it was practice.
    """

    path: Path
    result: Evaluation
    label: RunLabel
    flags: tuple[Flag, ...] = ()


def score_run(run: RunPath, rules: Sequence[RulesetName | None]) -> tuple[ScoredPath, ...]:
    """Score one run by each of some rulesets; it is read only once.

    None = the ruleset of the run. EUROBENCH's files are scored by `eurobench-2020` alone.
    """
    flags: list[tuple[Flag, ...]]
    with _naming(run.path):
        if run.prefix:
            published = read_run(run.path, run.prefix)
            if RulesetName.PROTOCOL in rules:
                raise ScoringError("csv files are scored by eurobench-2020: protocol needs the bag")
            pairs = [evaluate_published(published)] * len(rules)
            condition = published.condition
            subject, _, number = numbers_of(run.prefix)
            label = RunLabel(subject, "", condition.number, number)
            flags = [_flags_of(published) for _ in pairs]
        else:
            scored = score_recording(run.path, rules)
            pairs = [(scoring.result, scoring.rows) for scoring in scored]
            flags = [scoring.flags for scoring in scored]
            condition = scored[0].record.setup.condition
            label = scored[0].record.label
    return tuple(
        ScoredPath(Path(run.name), Evaluation.of(*pair, condition), label, flagged)
        for pair, flagged in zip(pairs, flags, strict=True)
    )


def _flags_of(published: EurobenchRun) -> tuple[Flag, ...]:
    settings = published.run_info.get("settings")
    if not isinstance(settings, dict):
        return ()
    source = next((kind for kind in SourceKind if kind == settings.get("source")), None)
    competition = str(settings.get("competition"))
    return tuple(practice_flags(source, competition, practice=settings.get("practice") is True))


def score_recording(path: Path, rules: Sequence[RulesetName | None] = (None,)) -> list[Scored]:
    """As `score_run`, of a bag or a run folder."""
    with _naming(path):
        recorded = read_recorded_run(path)
        return [
            Scored.of(recorded.record, recorded.run, assessment)
            for assessment in _assess(recorded, rules)
        ]


def score_with_series(path: Path, rules: RulesetName | None) -> tuple[Scored, WholeSeries]:
    """As `score_recording`, with the samples of all sensors."""
    with _naming(path):
        recorded = read_recorded_run(path)
        run = recorded.run
        (assessment,) = _assess(recorded, (rules,))
        scored = Scored.of(recorded.record, run, assessment)
        return scored, assessment.series(run.ending, run.rulings)


def score_opened(path: Path) -> Scored:
    """The stored result with the data of its recording; scored anew where there is none."""
    opened = open_run(path)
    scored = Scored.of(opened.recorded.record, opened.recorded.run, opened.assessment)
    stored = None if opened.out_of_date else read_sound_result(str(path))
    if stored is None:
        return scored
    issued = Result(**{each.name: getattr(stored, each.name) for each in fields(Result)})
    problem = _problem_of(opened.recorded.bag)
    if problem is None or _values(scored.result) == _values(issued):
        return replace(scored, result=issued)
    # what the recording has lost since then must not be drawn beside the values of the result
    remarks = (*issued.quality.remarks, f"{problem}: no figure shows the rest of it")
    issued = replace(issued, quality=replace(issued.quality, remarks=remarks))
    nothing = replace(scored.rows.cut(math.inf, math.inf), occupied={})
    return replace(scored, result=issued, rows=nothing)


def _values(result: Result) -> list[float | None]:
    return [indicator.value for indicator in result.indicators.values()]


def score_once(path: Path) -> Scored:
    """As `score_opened`, cached until result or journal of the run change."""
    return _score_as_of(path, *(stamp_of(f"{path}/{name}") for name in (RESULT_FILE, JOURNAL_FILE)))


@lru_cache(maxsize=64)
def _score_as_of(path: Path, *_stamps: Stamp | None) -> Scored:
    return score_opened(path)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Any error becomes a `MadrobError` that names the path."""
    try:
        yield
    except (MadrobError, RecorderError, ScoringError) as error:
        words = str(error)
        raise MadrobError(words if str(path) in words else f"{path}: {words}") from None
    except OSError as error:
        raise MadrobError(
            f"{path}: cannot be read ({error.strerror}); check the path and its permissions"
        ) from None
    except Exception as error:  # whatever it is, it is this run's and no other's
        why = terminal_safe(f"{type(error).__name__} {str(error)[:120]}".rstrip())
        raise MadrobError(f"{path}: is damaged ({why}): please report it") from error


def read_recorded_run(path: Path) -> RecordedRun:
    """Read what a bag or a run folder says of its run; a run that goes on is refused.

    The journal file comes first, which also has what the referee said after the recording;
    without it the journal in the bag is used. Where another tool lost the record `madrob_run`, the
    set-up is that of the journal. RecorderError if there is no bag.
    """
    _refuse_unfinished(path)
    bag = Bag(path)
    entries, remarks = _journal_file(path)
    lost = ""
    if not entries:
        entries = tuple(_journal_in(bag))
    metadata = bag.records.get(RECORD_NAME)
    try:
        if metadata is None:
            record, lost = record_from(entries if bag.topics() else ())
        else:
            record = RunRecord.from_metadata(metadata)
    except MadrobError as error:
        raise MadrobError(f"{path}: {error}") from None
    rebuilt = rebuild(entries, record.handle_zero, record.zero_samples)
    run = replace(rebuilt, journal=mark_of(entries), record_lost=lost)
    if run.setup is not None:
        run = replace(run, setup=replace(run.setup, competition=record.competition))
    if run.start is None:
        raise MadrobError(f"{path}: the run was never started, there is nothing to score")
    corrected = record.corrected(run) if run.corrections else record
    return RecordedRun(bag, corrected, record, entries, run, remarks)


def _journal_file(path: Path) -> tuple[tuple[Entry, ...], tuple[str, ...]]:
    journal = path / JOURNAL_FILE
    try:
        return read_journal(journal)
    except (FileNotFoundError, NotADirectoryError):
        return (), ()
    except OSError as error:
        return (), (f"{journal.name} cannot be read ({refusal(error)}): the bag's journal is used",)


def lines_lost(folder: Path) -> Iterator[Entry]:
    """The lines of the recording's own journal that the journal file has not."""
    with _naming(folder), suppress(FileNotFoundError, NotADirectoryError):
        lines = {*read_all(folder / JOURNAL_FILE, LARGEST_JOURNAL).split(b"\n")}
        yield from (
            entry for entry in _journal_in(Bag(folder)) if entry.to_json().encode() not in lines
        )


def _journal_in(bag: Bag) -> Iterable[Entry]:
    if REFEREE_EVENT_TOPIC not in {topic.name for topic in bag.topics()}:
        return
    types = standard_types()
    for message in bag.messages():
        if message.topic == REFEREE_EVENT_TOPIC:
            yield Entry.from_json(decode_text(types, message.data))


def _refuse_unfinished(path: Path) -> None:
    with suppress(OSError):  # reading the bag says what is wrong
        folder = path if path.is_dir() else path.parent
        if not (folder / RESULT_FILE).exists() and is_held(folder / JOURNAL_FILE):
            raise MadrobError(
                f"{path}: the run goes on, another console works on this run: wait for its result"
            )


def _refuse_unusable_journal(folder: Path) -> None:
    """Refuse a journal that would be appended to without having been read."""
    with suppress(FileNotFoundError):
        read_run_journal(folder)


def assess_recording(folder: Path, record: RunRecord, run: Run, *, stored: bool) -> Assessment:
    """Assess a known run's recording again, to the end of its bag.

    Its journal is not read, since an engine writes it. `stored` keeps what the stored result says
    of the data and the bag cannot tell. Nobody may record into the folder any more.
    """
    with _naming(folder):
        recorded = RecordedRun(Bag(folder), record, record, (), run, ())
        (assessment,) = _assess(recorded, (None,))
    if stored:
        keep_stored_losses(assessment, folder)
    return assessment


def _assess(recorded: RecordedRun, rules: Sequence[RulesetName | None]) -> list[Assessment]:
    """Assess a recorded run to the end of its bag, by each of some rulesets.

    None = the ruleset of its last re-issue, else the one that was set.
    """
    load_filters()
    run, record, bag = recorded.run, recorded.record, recorded.bag
    assert run.start is not None
    assessments = [record.assessment(run.start, name or run.ruleset) for name in rules]
    decoder = Decoder(record.mappings, types_of(bag.topics()))
    for message in bag.messages():
        try:
            sample = decoder.decode(message)
        except MessageError as error:
            for assessment in assessments:
                assessment.report_problem(str(error))
            continue
        if sample is not None:
            for assessment in assessments:
                assessment.feed(sample)
        if remark := decoder.remark:
            for assessment in assessments:
                assessment.report_problem(*remark)
    for assessment in assessments:
        assessment.release(math.inf)
        report_bag(assessment, recorded)
    return assessments


def report_bag(assessment: Assessment, recorded: RecordedRun) -> None:
    """Adds what is wrong with a recording, once it is read, to the result."""
    for remark in recorded.remarks:
        assessment.report_problem(remark)
    if (problem := _problem_of(recorded.bag)) is not None:
        assessment.report_problem(problem)
        if (lost := _lost_steps(assessment, recorded)) is not None:
            assessment.report_problem(lost)


def _problem_of(bag: Bag) -> str | None:
    """What of a recording cannot be read, without the place of its folder, which may be moved."""
    return None if bag.problem is None else bag.problem.removeprefix(f"{bag.path.parent}/")


def _lost_steps(assessment: Assessment, recorded: RecordedRun) -> str | None:
    """The steps of a completed run that its torn bag lacks, in words; None = it has all.

    A line of the journal is on disk at once, the samples behind it up to half a second later.
    """
    run, entries = recorded.run, recorded.entries
    if run.outcome is not Outcome.COMPLETED:
        return None
    before = takewhile(lambda entry: entry.what != Change.RUN_STOPS, entries)
    rulings = rebuild(tuple(before), recorded.record.handle_zero).rulings
    # other rules than those that stopped the run find the last steps a little after its stop
    procedures = (assessment.procedure(rulings, until) for until in (run.stop, None))
    done = {record.step for procedure in procedures for record in procedure.steps if record.done}
    lost = [str(step.value) for step in Step if step not in done]
    if not lost:
        return None
    return (
        "the run was completed, but its recording ends before that: what was seen of step "
        f"{' and '.join(lost)} is lost, only the referee can confirm it"
    )


def open_run(folder: Path, rules: RulesetName | None = None) -> OpenedRun:
    """Read a run, to look at it and to go on with it; `rules` None = those of its result."""
    with _naming(folder):
        _refuse_unusable_journal(folder)
        recorded = read_recorded_run(folder)
        (assessment,) = _assess(recorded, (rules,))
    keep_stored_losses(assessment, folder)
    return OpenedRun(folder, recorded, assessment, _out_of_date(folder, recorded.run))


def _out_of_date(folder: Path, run: Run) -> bool:
    try:
        result = read_result(str(folder))
    except FileNotFoundError:
        return True
    except UnusableResultError as error:
        return isinstance(error, DamagedResultError)
    return any(disagreements(result, run))


def keep_stored_losses(assessment: Assessment, folder: Path) -> None:
    """Keep what a stored result says of the recording's losses, which the bag cannot tell."""
    stored = read_sound_result(str(folder))
    if stored is not None:
        assessment.lost = stored.quality.lost
