"""The files of a run's result (protocol section 10): what stands in them, and writing them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec

from madrob_console.archive.folders import ISSUE_FILE, RESULT_FILE
from madrob_console.archive.result_document import ResultDocument
from madrob_console.archive.result_reader import LARGEST_RESULT
from madrob_console.archive.scored import Scored
from madrob_console.errors import MadrobError
from madrob_console.files.bounded import read_all
from madrob_console.files.plain import refusal
from madrob_console.files.whole import atomic_write, atomic_writes
from scoring.errors import ScoringError
from scoring.eurobench.run_files import Wrench, run_files
from scoring.eurobench.run_info import RunInfo
from scoring.protocol import Event, Outcome

ResultFiles = Mapping[str, bytes | memoryview]
"""Every file of a result by its name, in the order in which they are written."""


def result_files(folder: Path, scored: Scored) -> dict[str, bytes]:
    """Every file of the result, to be written into the run's folder; `result.json` is the last.

    Args:
        folder: holds the recording, whose digest stands in the result.
        scored: the run.

    Raises:
        MadrobError: something that was set for the run cannot be written down.
    """
    data = eurobench_files(folder.name, scored)
    document = msgspec.json.encode(ResultDocument.of(scored, folder, data))
    return data | {RESULT_FILE: msgspec.json.format(document, indent=2) + b"\n"}


def eurobench_files(name: str, scored: Scored) -> dict[str, bytes]:
    """EUROBENCH's files of a run: set-up, pre-processed data and indicators (section 10).

    Args:
        name: of the run's folder.
        scored: the run.

    Raises:
        MadrobError: something that was set for the run cannot be written down.
    """
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


def write_result(folder: Path, files: ResultFiles, issue: int) -> None:
    """Write the files of a result that are not there yet; an earlier issue is kept by its number.

    A folder that was deleted is made again: the result is all that is left of the run.

    Args:
        folder: of the run.
        files: as `result_files` made them.
        issue: number of the result's issue.

    Raises:
        MadrobError: a file cannot be written; the recording is untouched.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MadrobError(
            f"{folder}: cannot be written ({error.strerror}): check disk space and permissions"
        ) from None
    data = {name: content for name, content in files.items() if name != RESULT_FILE}
    changed = {name: data[name] for name in data if not has_content(folder / name, data[name])}
    atomic_writes(folder, changed)
    _keep_earlier_issue(folder, issue)
    atomic_write(folder / RESULT_FILE, files[RESULT_FILE])


def _keep_earlier_issue(folder: Path, issue: int) -> None:
    """Keep the result of the issue before this one under its number, once."""
    current, kept = folder / RESULT_FILE, folder / ISSUE_FILE.format(issue - 1)
    try:
        if issue < 2 or kept.exists():
            return
        earlier = read_all(current, LARGEST_RESULT)
    except FileNotFoundError:
        return
    except OSError as error:
        raise MadrobError(f"{current}: cannot be read ({refusal(error)})") from None
    atomic_write(kept, earlier)


def has_content(path: Path, content: bytes | memoryview) -> bool:
    """Whether a file has this content: it has it on disk then, for it was written whole."""
    try:
        return read_all(path, len(content)) == content
    except OSError:
        return False
