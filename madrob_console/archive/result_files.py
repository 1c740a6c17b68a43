"""Makes the files of a result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import msgspec

from madrob_console.archive.file_digests import digests_of
from madrob_console.archive.folders import RESULT_FILE, RESULT_FORMAT
from madrob_console.archive.result_document import MANUAL_START, ResultDocument
from madrob_console.archive.scored import Scored
from scoring.eurobench import run_files
from scoring.protocol import Event, Outcome
from scoring.result import Result, libraries_here
from scoring.run_info import RunInfo


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
    assert run.journal is not None
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
        faults=run.faults,
        voided=run.voided,
        corrections=run.corrections,
        accepted_doubts=run.accepted_doubts,
        protests=run.protests,
        taken_back=run.taken_back,
        reissues=run.reissues,
        remark=MANUAL_START,
        files=files,
        files_left_out=left_out,
        journal=run.journal,
        flags=scored.flags,
        evidence=run.evidence,
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
    return run_files(
        info,
        [Event(event.time, event.event) for event in result.events],
        rows,
        {} if result.outcome is Outcome.ABORTED else result.indicators,
    )
