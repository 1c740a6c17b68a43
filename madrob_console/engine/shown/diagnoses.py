"""The state in the form in which ROS programs hear how a machine is: `/diagnostics`.

Nothing is judged here: words and faults are those that the screens show.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from madrob_console.referee.health import Freshness
from madrob_console.referee.on_record import CheckName
from madrob_console.referee.preflight import CheckState
from madrob_console.testbeds.outside import Diagnosis, Level

if TYPE_CHECKING:
    from madrob_console.referee.amounts import size_words
from madrob_console.engine.shown.snapshot import Snapshot, TopicView

_ENGINE = "engine"
_LEVELS = {
    Freshness.FRESH: Level.WARN,
    Freshness.STALE: Level.WARN,
    Freshness.LOST: Level.STALE,
    Freshness.NEVER: Level.ERROR,
}
"""Of a topic with which something is wrong."""


def diagnoses(snapshot: Snapshot, rate: float) -> tuple[Diagnosis, ...]:
    """How engine, recorder, disk and each topic are.

    Args:
        snapshot: the state.
        rate: what the topics should have, Hz.
    """
    topics = tuple(_topic(view, rate) for view in snapshot.topics)
    told = (_recorder(snapshot), _disk(snapshot), *topics)
    if snapshot.pulse.stale:  # what is known of them is old
        words = str(snapshot.pulse.words)
        told = tuple(replace(one, level=Level.STALE, message=words) for one in told)
    return (_engine(snapshot), *told)


def failure(words: str) -> Diagnosis:
    """Of an engine that has failed, which says why."""
    return Diagnosis(_ENGINE, Level.ERROR, words)


def _engine(snapshot: Snapshot) -> Diagnosis:
    pulse, setup = snapshot.pulse, snapshot.run.setup
    values = {
        "phase": str(snapshot.run.phase),
        "core silent, s": str(pulse.core),
        "testbed": snapshot.label,
        "subject": "" if setup is None else str(setup.subject),
        "run": "" if setup is None else str(setup.run_number),
    }
    if pulse.stale:
        return Diagnosis(_ENGINE, Level.ERROR, str(pulse.words), values)
    faults = tuple(_of_engine(snapshot))
    level = Level.WARN if faults else Level.OK
    return Diagnosis(_ENGINE, level, "; ".join(faults) or str(snapshot.run.phase), values)


def _of_engine(snapshot: Snapshot) -> Iterator[str]:
    """Faults that neither the recorder nor a topic tells of itself."""
    others = ("recorder: ", *(f"{view.topic}: " for view in snapshot.topics))
    return (fault for fault in snapshot.faults if not fault.startswith(others))


def _recorder(snapshot: Snapshot) -> Diagnosis:
    recorder = snapshot.recorder
    lost = sum(view.lost or 0 for view in snapshot.topics)
    values = {
        "messages": str(recorder.messages),
        "bytes": str(recorder.size),
        "queue, bytes": str(recorder.queued),
        "dropped": str(recorder.dropped),
        "lost on the way": str(lost),
    }
    faults = [f for f in snapshot.faults if f.startswith("recorder: ")]
    words = "; ".join(fault.removeprefix("recorder: ") for fault in faults)
    level = Level.ERROR if faults else Level.OK
    return Diagnosis("recorder", level, words or recorder.state, values)


def _disk(snapshot: Snapshot) -> Diagnosis:
    silent, free = snapshot.pulse.disk, snapshot.disk_free
    values = {
        "free, bytes": "" if free is None else str(free),
        "silent, s": str(silent),
        "lines waiting": str(snapshot.pulse.unwritten),
    }
    if silent:
        return Diagnosis("disk", Level.ERROR, f"silent for {silent} s", values)
    check = next((check for check in snapshot.checks if check.name is CheckName.DISK), None)
    if check is not None:
        return Diagnosis("disk", _CHECKED[check.state], check.reason, values)
    if free is None:
        return Diagnosis("disk", Level.STALE, "free space unknown", values)
    return Diagnosis("disk", Level.OK, f"{size_words(free)} free", values)


_CHECKED = {
    CheckState.OK: Level.OK,
    CheckState.WARNING: Level.WARN,
    CheckState.FAILED: Level.ERROR,
    CheckState.NO_DATA: Level.STALE,
    CheckState.WAIVED: Level.WARN,
}


def _topic(view: TopicView, rate: float) -> Diagnosis:
    values = {
        "rate, Hz": "" if view.rate is None else f"{view.rate:.1f}",
        "age, s": "" if view.age is None else f"{view.age:.3f}",
        "expected, Hz": "" if view.optional else f"{rate:g}",
        "received": str(view.received),
        "lost": "" if view.lost is None else str(view.lost),
        "publishers": str(view.publishers),
    }
    if view.problem is None:
        absent = view.freshness is Freshness.NEVER
        words = f"{view.freshness} (optional)" if absent else str(view.freshness)
        return Diagnosis(view.topic, Level.OK, words, values)
    return Diagnosis(view.topic, _LEVELS[view.freshness], view.problem, values)
