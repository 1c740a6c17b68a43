"""Writes the files of a run's result (protocol section 10)."""

from __future__ import annotations

from pathlib import Path

import msgspec

from madrob_console.archive.folders import RESULT_FILE
from madrob_console.archive.result_document import ResultDocument
from madrob_console.archive.scored import Scored
from madrob_console.errors import MadrobError
from madrob_console.files.whole import atomic_write
from scoring.errors import ScoringError
from scoring.eurobench.run_files import Wrench, write_run_files
from scoring.eurobench.run_info import RunInfo
from scoring.protocol import Event, Outcome


def write_results(folder: Path, scored: Scored) -> None:
    """Write every file of the result; a result that was final before is kept by its number.

    A folder that was deleted is made again: the result is all that is left of the run.

    Raises:
        MadrobError: a file cannot be written; the recording is untouched.
    """
    record, run, result, rows = scored.record, scored.run, scored.result, scored.rows
    setup = record.setup
    info = RunInfo(
        subject=setup.subject,
        team=setup.team,
        run_number=setup.run_number,
        condition=setup.condition,
        start_time=result.start,
        start_pose=setup.start_pose,
        timeout=setup.timeout,
        ruleset=result.ruleset,
        rosbag_path=f"{folder.name}_0.mcap",
        settings={
            "referee": setup.referee,
            "countdown": setup.countdown,
            "lock_detection": result.lock_detection.value,
            "handle_zero": record.handle_zero,
            "source": record.source.value,
            "competition": record.competition,
        },
    )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_run_files(
            folder,
            info,
            [Event(event.time, event.event) for event in result.events],
            rows.joint_state,
            Wrench(rows.force_time, rows.force),
            {} if result.outcome is Outcome.ABORTED else result.indicators,
        )
    except ScoringError as error:
        raise MadrobError(str(error)) from None
    except OSError as error:
        raise MadrobError(
            f"{folder}: cannot be written ({error.strerror}): check disk space and permissions"
        ) from None
    _keep_earlier_issue(folder, run.issue)
    text = msgspec.json.format(msgspec.json.encode(ResultDocument.of(scored, folder)), indent=2)
    atomic_write(folder / RESULT_FILE, text + b"\n")


def _keep_earlier_issue(folder: Path, issue: int) -> None:
    """Keep the result of the issue before this one under its number, once."""
    current, kept = folder / RESULT_FILE, folder / f"result_issue_{issue - 1}.json"
    try:
        if issue < 2 or kept.exists() or not current.exists():
            return
        atomic_write(kept, current.read_bytes())
    except OSError as error:
        raise MadrobError(f"{current}: cannot be read ({error.strerror})") from None
