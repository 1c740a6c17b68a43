"""What makes a value doubtful: few samples behind an edge, gaps, spikes, drift (section 11).

A doubt is a sentence beside a value. It never changes one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from scoring.deciding import DecidingEdge, EdgeKind
from scoring.grounds import Grounds
from scoring.indicator_table import IndicatorName as Name
from scoring.kinematics import Array
from scoring.protocol import Signal, Thresholds
from scoring.quality import QualityCounter
from scoring.rest import FEWEST_SAMPLES

Doubt = tuple[tuple[Name, ...], str]
"""The indicators that are doubted, and why, in a sentence."""

_MOTION = (Name.SMOOTHNESS_OF_DOOR_ACTUATION, Name.UNSAFETY_OF_DOOR_OPERATION)
_FORCE = (*EdgeKind.TOUCH.indicators, Name.ROUGHNESS_OF_DOOR_ACTUATION)
_CLOSING_TIMES = (Name.EXECUTION_TIME, Name.PASSAGE_TIME)
_UNDER_SENSORS = (EdgeKind.ARRIVAL, EdgeKind.DEPARTURE)
_FILTER_REACH = 1.0
"""The filters of the door angle reach so far out of the run, s."""


def all_doubts(grounds: Grounds) -> dict[Name, tuple[str, ...]]:
    """Every doubt on a run, by indicator; those without any are missing."""
    with np.errstate(over="ignore", invalid="ignore"):  # of what only `eurobench-2020` believes
        found = (
            *edge_doubts(grounds.edges, grounds.counters, grounds.thresholds),
            *_gaps_near_edges(grounds),
            *_gaps_near_maxima(grounds),
            *_missing_samples(grounds),
            *_spikes(grounds),
            *_impossible(grounds),
            *_clipped(grounds),
            *_stuck(grounds),
            *_drift(grounds),
            *_chatter(grounds),
            *_delays(grounds),
            *_rate(grounds),
        )
    return by_indicator(found)


def by_indicator(found: Iterable[Doubt]) -> dict[Name, tuple[str, ...]]:
    """Doubts by indicator, in the protocol's order, each sentence once."""
    told: dict[Name, dict[str, None]] = {name: {} for name in Name}
    for names, words in found:
        for name in names:
            told[name][words] = None
    return {name: tuple(words) for name, words in told.items() if words}


def edge_doubts(
    edges: Iterable[DecidingEdge],
    counters: Mapping[Signal, QualityCounter],
    thresholds: Thresholds,
) -> Iterator[Doubt]:
    """Edges that rest on little; known while the run goes on."""
    limits = thresholds.doubt
    for edge in edges:
        if edge.readings < limits.least_readings:
            samples = f"{edge.readings} sample{'s' if edge.readings != 1 else ''}"
            yield edge.indicators, f"{edge.kind.words} rests on {samples}"
            continue
        counter = counters.get(edge.signal)
        tolerance = (counter.interval or 0.0) / 2 if counter is not None else 0.0
        if edge.alone is not None and edge.alone + tolerance < limits.least_hold:
            alone = f"one passage sensor for {1000 * edge.alone:.0f} ms"
            yield edge.indicators, f"{edge.kind.words} rests on {alone}"


def _gaps_near_edges(g: Grounds) -> Iterator[Doubt]:
    for edge in g.edges:
        limits, counter = g.thresholds.doubt, g.counters.get(edge.signal)
        gap = _gap_near(_holes(g, edge.signal), edge.time, limits.gap_reach)
        usual = counter.interval if counter is not None else None
        unreadable = counter is not None and counter.no_reading > 0
        if gap is None and unreadable and usual is not None and edge.since is not None:
            unread = edge.time - edge.since  # samples came and said nothing
            gap = unread if unread > limits.gap_intervals * usual else None
        if edge.kind in _UNDER_SENSORS:
            # where the panel is decides which sensors it masks
            blind = _gap_near(_holes(g, Signal.DOOR), edge.time, limits.gap_reach)
            if blind is not None:
                words = f"door angle: no sample for {blind:.3f} s near {edge.kind.words}"
                yield edge.indicators, words
        if gap is not None:
            near = f"near {edge.kind.words}"
            yield edge.indicators, f"{edge.signal.value}: no sample for {gap:.3f} s {near}"


def _gaps_near_maxima(g: Grounds) -> Iterator[Doubt]:
    rows, reach = g.rows, g.thresholds.doubt.gap_reach
    motion = rows.joint_state.time, rows.low_passed
    maxima = (
        (Name.UNSAFETY_OF_DOOR_OPERATION, Signal.DOOR, *motion, "largest acceleration"),
        (
            Name.ROUGHNESS_OF_DOOR_ACTUATION,
            Signal.HANDLE,
            rows.force_time,
            rows.force - rows.rest,
            "largest force",
        ),
    )
    for name, signal, times, values, words in maxima:
        if not np.isfinite(values).any():
            continue
        at = float(times[int(np.nanargmax(np.abs(values)))])
        gap = _gap_near(_holes(g, signal), at, reach)
        if gap is not None:
            yield (name,), f"{signal.value}: no sample for {gap:.3f} s near the {words}"


def _holes(g: Grounds, signal: Signal) -> list[tuple[float, float]]:
    """The intervals of a signal without a reading, longer than they should be."""
    counter, intervals = g.counters.get(signal), g.thresholds.doubt.gap_intervals
    if counter is None:
        return []
    times = {Signal.DOOR: g.door_time, Signal.HANDLE: g.force_time}.get(signal)
    if times is None:
        return counter.longer_than(intervals)
    steps, usual = np.diff(times), counter.interval
    longer = np.flatnonzero(steps > intervals * usual) if usual else np.empty(0, np.intp)
    return [(float(times[i]), float(times[i + 1])) for i in longer]


def _gap_near(holes: Iterable[tuple[float, float]], time: float, reach: float) -> float | None:
    """The longest of some gaps that come near a time, s; None = none does."""
    near = (until - since for since, until in holes if since - reach < time < until + reach)
    return max(near, default=None)


def _open_intervals(g: Grounds) -> Array:
    """The intervals between the door's readings while it is open, in the run, s, shape (m,)."""
    is_open = np.abs(g.door_angle) > g.thresholds.closed_angle
    within = (g.door_time >= g.start) & (g.door_time <= g.end)
    counted = is_open & within
    return np.diff(g.door_time)[counted[1:] | counted[:-1]]


def _missing_samples(g: Grounds) -> Iterator[Doubt]:
    intervals, limits = _open_intervals(g), g.thresholds.doubt
    if not intervals.size:
        return
    usual, nominal = float(np.median(intervals)), 1 / g.thresholds.rate
    if usual >= limits.gap_intervals * nominal:  # so many are missing that it is the usual
        usual = nominal
    steps = np.round(intervals / usual)
    missing, expected = int((steps - 1).clip(0).sum()), int(steps.clip(1).sum())
    if missing > limits.missing * expected:
        yield _MOTION, f"{missing} of {expected} samples of the open door are missing"
    regular = intervals[intervals < limits.gap_intervals * usual]
    jitter = float(regular.std()) if regular.size else 0.0
    if jitter > limits.jitter:
        yield _MOTION, f"the door's stamps jitter by {1000 * jitter:.1f} ms"


def _spikes(g: Grounds) -> Iterator[Doubt]:
    steps = np.diff(g.door_angle)
    speeds = steps / np.diff(g.door_time)
    fast = np.abs(speeds) > g.thresholds.doubt.spike_velocity
    back = fast[1:] & fast[:-1] & (np.sign(speeds[1:]) != np.sign(speeds[:-1]))
    places = np.flatnonzero(back)
    places = places[_within_filters(g, g.door_time[places + 1])]
    if not places.size:
        return
    largest, when = float(np.abs(steps[places]).max()), _when(g, g.door_time[places + 1])
    yield _MOTION, f"the door angle steps by up to {largest:.2g} rad and back, {when}"
    made = {float(time) for index in places for time in g.door_time[index + 1 : index + 3]}
    for edge in g.edges:
        if edge.signal is Signal.DOOR and edge.time in made:
            words = f"{edge.kind.words} is a step of one sample and back"
            yield edge.indicators, words


def _impossible(g: Grounds) -> Iterator[Doubt]:
    """Steps and back, too, of which nothing is left but the hole that the filters step over."""
    times = g.impossible_angles[_within_filters(g, g.impossible_angles)]
    if times.size:
        most = f"{g.thresholds.largest_angle:g} rad"
        yield _MOTION, f"the door angle is beyond {most}, which it cannot be, {_when(g, times)}"


def _within_filters(g: Grounds, times: Array) -> NDArray[np.bool_]:
    """Which times the filters of the run reach."""
    if not g.ruleset.cut_rows:
        return np.ones(times.shape, np.bool_)
    return (times >= g.start - _FILTER_REACH) & (times <= g.end + _FILTER_REACH)


def _when(g: Grounds, times: Array) -> str:
    count = f"{times.size} times, first" if times.size > 1 else "once,"
    return f"{count} {float(times[0]) - g.start:.2f} s after the start"


def _clipped(g: Grounds) -> Iterator[Doubt]:
    force = g.rows.force
    if not force.size:
        return
    top = force[int(np.argmax(np.abs(force - g.rows.rest)))]
    longest = max((r.stop - r.start for r in _runs(force == top)), default=0)
    pressed = abs(top - g.handle_zero) > g.thresholds.touch_force
    if pressed and longest >= g.thresholds.doubt.clipped:
        words = f"the largest force stands still for {longest} samples: clipped"
        yield (Name.ROUGHNESS_OF_DOOR_ACTUATION,), words


def _stuck(g: Grounds) -> Iterator[Doubt]:
    still = np.diff(g.force) == 0
    at_rest = still[g.force_time[1:] < g.start]
    if at_rest.size < FEWEST_SAMPLES or at_rest.mean() >= 0.5:
        return  # its steps are coarser than its noise
    longest = 0.0
    for run in _runs(still):
        since, until = g.force_time[run.start], g.force_time[run.stop]
        if since < g.end and until > g.start:
            longest = max(longest, float(until - since))
    if longest >= g.thresholds.doubt.stuck_time:
        yield _FORCE, f"the handle force does not change for {longest:.1f} s"


def _runs(flags: NDArray[np.bool_]) -> list[slice]:
    """Where flags are set one after the other."""
    borders = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in zip(borders[::2], borders[1::2], strict=True)]


def _drift(g: Grounds) -> Iterator[Doubt]:
    drift = g.rest.drift
    if drift is not None and abs(drift) > g.thresholds.doubt.drift * g.thresholds.touch_force:
        yield _FORCE, f"the handle at rest after the run is {drift:+.2f} N off its zero"


def _chatter(g: Grounds) -> Iterator[Doubt]:
    times, allowed = g.door_edges, g.thresholds.doubt.chatter
    within = zip(times, times[allowed:], strict=False)
    if any(last - first <= 1.0 for first, last in within):
        yield _CLOSING_TIMES, f"the door opens and closes more than {allowed} times within a second"


def _delays(g: Grounds) -> Iterator[Doubt]:
    signals = {edge.kind: edge.signal for edge in g.edges}
    for name in Name:
        joined = {s for kind, s in signals.items() if name in kind.indicators}
        known = [c for s in sorted(joined, key=lambda s: s.value) if (c := g.counters.get(s))]
        for one, other in combinations(known, 2):
            if one.delay is None or other.delay is None or not one.interval or not other.interval:
                continue
            allowed = g.thresholds.doubt.delay_intervals * max(one.interval, other.interval)
            if (difference := abs(one.delay - other.delay)) > allowed:
                two = f"{one.signal.value} and {other.signal.value}"
                yield (name,), f"stamps of {two} differ in delay by {1000 * difference:.0f} ms"


def _rate(g: Grounds) -> Iterator[Doubt]:
    counter = g.counters.get(Signal.DOOR)
    if counter is None or not counter.interval:
        return
    rate, nominal = 1 / counter.interval, g.thresholds.rate
    if not math.isclose(rate, nominal, rel_tol=0, abs_tol=g.thresholds.doubt.rate * nominal):
        words = f"the door is sampled at {rate:.1f} Hz, the testbed's rate is {nominal:g} Hz"
        yield (Name.SMOOTHNESS_OF_DOOR_ACTUATION,), words
