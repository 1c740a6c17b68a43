"""The files of a result: written, and read one after the other for tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from hashlib import sha256
from pathlib import Path

import msgspec
from msgspec import UNSET

from madrob_console.archive.file_digests import digests_of
from madrob_console.archive.folders import (
    PRACTICE_FOLDER,
    RESULT_FILE,
    RESULT_FORMAT,
    RunPath,
    RunPlace,
    parse_folder_name,
)
from madrob_console.archive.history import misplaced
from madrob_console.archive.result_document import MANUAL_START, ResultDocument
from madrob_console.archive.result_reader import UnusableResultError, read_result
from madrob_console.archive.run_journal import UnusableJournalError, disagreement, out_of_date
from madrob_console.archive.run_record import RunLabel
from madrob_console.archive.scored import Scored, score_recording
from madrob_console.common.errors import MadrobError
from madrob_console.referee.flags import undecided
from scoring.eurobench.run_files import Wrench, run_files
from scoring.eurobench.run_info import RunInfo
from scoring.libraries import libraries_here
from scoring.protocol import Condition, Event, Outcome, ScoringError
from scoring.result import Result
from scoring.rulesets import RulesetName

_SHORT = 16
"""Digits of a digest that people compare."""


def result_files(folder: Path, scored: Scored, inside: Path | None = None) -> dict[str, bytes]:
    """Every file of the result; `result.json` is the last.

    `folder` holds the recording; an engine has it open, as `inside`.
    """
    data = eurobench_files(folder.name, scored)
    document = msgspec.json.encode(document_of(scored, folder, data, inside))
    return data | {RESULT_FILE: msgspec.json.format(document, indent=2) + b"\n"}


def document_of(
    scored: Scored, folder: Path, data: Mapping[str, bytes], inside: Path | None = None
) -> ResultDocument:
    """What `result.json` says; `data` are the other new files, the rest as `result_files`."""
    record, run, setup = scored.record, scored.run, scored.record.setup
    files, left_out = digests_of(inside or folder, data, folder.name)
    return ResultDocument(
        format=RESULT_FORMAT,
        software=f"madrob-console {record.version}",
        competition=record.competition,
        source=record.source,
        issue=run.issue,
        subject=setup.subject,
        team=setup.team,
        run_number=setup.run_number,
        condition_number=setup.condition.number,
        setup=setup,
        run_id=setup.run_id,
        testbed=setup.testbed,
        thresholds=record.thresholds,
        **{each.name: getattr(scored.result, each.name) for each in fields(Result)},
        waivers=run.waivers,
        false_starts=run.false_starts,
        incidents=run.incidents,
        rulings=run.rulings,
        notes=run.notes if run.closure is None else run.notes[: run.signed_notes],
        closure=run.closure,
        voided=run.voided,
        corrections=run.corrections,
        accepted_doubts=run.accepted_doubts,
        protests=run.protests,
        taken_back=run.taken_back,
        reissues=run.reissues,
        removed_evidence=run.removed_evidence,
        remark=MANUAL_START,
        files=files,
        files_left_out=left_out,
        journal=run.journal or UNSET,
        flags=scored.flags,
        evidence=run.evidence if run.closure is None else run.signed_evidence,
        zero_samples=record.zero_samples,
        robot_start=run.answered_at,
        mappings=record.mappings,
        libraries=libraries_here(),
    )


def eurobench_files(name: str, scored: Scored) -> dict[str, bytes]:
    """Set-up, pre-processed data and indicators (section 10); `name` is of the run's folder."""
    record, result, rows = scored.record, scored.result, scored.rows
    setup, first = record.setup, scored.run.set_up_as
    info = RunInfo(
        subject=setup.subject,
        team=setup.team,
        run_number=setup.run_number,
        condition=setup.condition,
        start_time=result.start,
        start_pose=setup.start_pose,
        timeout=setup.timeout,
        ruleset=result.ruleset,
        rosbag_path=f"{name}_0.mcap",
        settings={
            "referee": setup.referee,
            "countdown": setup.countdown,
            "lock_detection": result.lock_detection.value,
            "handle_zero": record.handle_zero,
            "source": record.source.value,
            "competition": record.competition,
            "practice": setup.practice,
            **({"run_id": setup.run_id, "testbed": setup.testbed} if setup.run_id else {}),
        },
        set_up_as=(
            (first.subject, first.condition.number, first.run_number)
            if first is not None and scored.run.corrections
            else None
        ),
    )
    try:
        return run_files(
            info,
            [Event(event.time, event.event) for event in result.events],
            rows.joint_state,
            Wrench(rows.force_time, rows.force),
            {} if result.outcome is Outcome.ABORTED else result.indicators,
        )
    except ScoringError as error:
        raise MadrobError(str(error)) from None


# Results of many runs, stored or fresh, one after the other, for tables.


@dataclass(frozen=True, slots=True)
class StoredRun:
    """A run with its result, as stored or freshly scored; `folder` may be a bag file."""

    folder: Path
    result: ResultDocument

    @property
    def label(self) -> RunLabel:
        result = self.result
        return RunLabel(
            result.subject,
            result.team,
            result.condition_number,
            result.run_number,
            result.run_id,
            result.testbed,
            result.competition,
        )

    @property
    def practice(self) -> bool:
        return self.result.practice or self.folder.parent.name == PRACTICE_FOLDER

    @property
    def condition(self) -> Condition:
        return Condition.from_number(self.result.condition_number)

    def place(self, name: str) -> RunPlace:
        return RunPlace(name, self.result.run_id, self.practice, self.result.issue)

    @property
    def undecided(self) -> int:
        return len(undecided(self.result.flags))

    @property
    def libraries(self) -> str:
        stored = self.result.libraries
        versions = {} if stored is UNSET else asdict(stored)
        return "; ".join(f"{name} {version}" for name, version in versions.items())

    @property
    def thresholds_changed(self) -> str:
        stored = self.result.thresholds
        unlike = {} if stored is UNSET else stored.unlike_protocol
        return "; ".join(f"{name} {value}" for name, value in unlike.items())

    @property
    def mapping_digest(self) -> str:
        """Equal where all signals were read alike; empty where the result does not tell."""
        stored = self.result.mappings
        if stored is UNSET:
            return ""
        ordered = msgspec.json.encode(sorted(stored, key=lambda mapping: mapping.signal.value))
        return sha256(ordered).hexdigest()[:_SHORT]

    @property
    def recording_digest(self) -> str:
        """As the result has it; empty where it has none."""
        files = self.result.files
        return next((files[name].sha256 for name in sorted(files) if name.endswith(".mcap")), "")


def stored_places(runs: Iterable[RunPath]) -> Iterator[RunPlace]:
    """Where the runs with a usable result lie."""
    for run in runs:
        with suppress(MadrobError):
            yield stored_run(run).place(run.name)


def valid_result(folder: Path) -> ResultDocument:
    """The result of a run, if its journal and its folder agree with it.

    Raises:
        FileNotFoundError: there is none.
        MadrobError: it cannot be used; says why.
    """
    result = read_result(str(folder))
    named = parse_folder_name(folder.name)
    why = None if named is None else misplaced(result, named[0])
    if why is None and (differing := disagreement(result, folder)) is not None:
        why = out_of_date(differing)
    if why is not None:
        raise UnusableResultError(why)
    return result


def stored_run(run: RunPath) -> StoredRun:
    folder = run.path
    try:
        return StoredRun(folder, valid_result(folder))
    except FileNotFoundError:
        why = f"has no {RESULT_FILE}: name folders with runs; the console decides on one cut off"
        why = why if folder.exists() else "no such folder; name folders with runs"
    except (UnusableResultError, UnusableJournalError) as error:
        why = str(error)
    raise MadrobError(f"{run.name}: {why}")


def fresh_runs(run: RunPath, rules: Sequence[RulesetName | None]) -> list[StoredRun]:
    """A recorded run scored now by each ruleset; it is read only once."""
    run.demand_recording()
    scored = score_recording(run.path, rules)
    return [StoredRun(run.path, document_of(scoring, run.path, {})) for scoring in scored]
