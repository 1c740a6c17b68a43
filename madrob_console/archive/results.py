"""The files of a run's result (protocol section 10)."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import msgspec

from madrob_console.archive.digests import digests_of
from madrob_console.archive.folders import RESULT_FILE, RESULT_FORMAT
from madrob_console.archive.result_document import ResultDocument
from madrob_console.archive.run_record import RunRecord
from madrob_console.errors import MadrobError
from madrob_console.files.whole import atomic_write
from madrob_console.referee.run import Run
from scoring.errors import ScoringError
from scoring.eurobench.run_files import Wrench, write_run_files
from scoring.eurobench.run_info import RunInfo
from scoring.protocol import Outcome
from scoring.result import Ending, Result
from scoring.rows import Rows

MANUAL_START = "execution time and time to handle include the delay of the manual start"


@dataclass(frozen=True, slots=True)
class Scored:
    """A scored run: what was set, what the referee said, the result and its data."""

    record: RunRecord
    run: Run
    result: Result
    rows: Rows


def ending_of(run: Run) -> Ending:
    """How a run ended, for its result.

    An interrupted run has no stop: the time at which the machine failed says nothing about the
    robot. So does a run whose journal ends before its stop.
    """
    if run.outcome is None:
        return Ending(Outcome.INTERRUPTED, "no stop is recorded: the run was cut off", None)
    interrupted = run.outcome is Outcome.INTERRUPTED
    return Ending(run.outcome, run.outcome_reason, None if interrupted else run.stop)


def scores(result: Result) -> dict[str, Any]:
    """Ruleset, outcome, indicators, steps, events and quality as JSON values."""
    start = result.start
    return {
        "ruleset": result.ruleset,
        "outcome": result.ending.outcome,
        "outcome_reason": result.ending.reason,
        "start": start,
        "stop": result.ending.stop,
        "indicators": {
            i.name: {"value": i.value, "unit": i.unit, "reason": i.reason}
            for i in result.indicators
        },
        "lock_detection": result.lock_detection,
        "steps": [
            {
                "step": int(s.step),
                "name": s.step.text,
                "sensors": s.sensors,
                "referee": None if s.ruling is None else asdict(s.ruling),
                "final": s.final,
                "reason": s.waiting or None,
            }
            for s in result.steps
        ],
        "events": [
            {"time": e.time, "since_start": e.time - start, "event": e.name} for e in result.events
        ],
        "quality": {
            "signals": [asdict(s) | {"signal": s.signal.value} for s in result.quality.signals],
            "remarks": list(result.quality.remarks),
        },
    }


def result_document(scored: Scored, folder: Path) -> ResultDocument:
    """The content of `result.json`; `folder` holds the recording and the data files."""
    record, run = scored.record, scored.run
    setup = record.setup
    files, left_out = digests_of(folder)
    document = {
        "format": RESULT_FORMAT,
        "software": f"madrob-console {record.version}",
        "competition": record.competition,
        "source": record.source,
        "issue": run.issue,
        "subject": setup.subject,
        "team": setup.team,
        "run_number": setup.run_number,
        "condition_number": setup.condition.number,
        "setup": setup,
        "handle_zero": record.handle_zero,
        **scores(scored.result),
        "waivers": run.waivers,
        "false_starts": run.false_starts,
        "incidents": run.incidents,
        "rulings": run.rulings,
        "notes": run.notes,
        "closure": run.closure,
        "remark": MANUAL_START,
        "files": files,
        "files_left_out": left_out,
    }
    return msgspec.convert(msgspec.to_builtins(document), ResultDocument)


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
    aborted = result.ending.outcome is Outcome.ABORTED
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_run_files(
            folder,
            info,
            result.events,
            rows.joint_state,
            Wrench(rows.force_time, rows.force),
            () if aborted else result.indicators,
        )
    except ScoringError as error:
        raise MadrobError(str(error)) from None
    except OSError as error:
        raise MadrobError(
            f"{folder}: cannot be written ({error.strerror}): check disk space and permissions"
        ) from None
    _keep_earlier_issue(folder, run.issue)
    text = msgspec.json.format(msgspec.json.encode(result_document(scored, folder)), indent=2)
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
