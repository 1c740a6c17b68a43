"""What makes a value doubtful: few samples behind an edge, gaps, spikes, drift (section 11).

A doubt is a sentence beside a value. It never changes one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from scoring.door_angle import DoorAngle, runs, without_top
from scoring.indicator_table import IndicatorName as Name
from scoring.indicators import (
    roughness_of_door_actuation,
    smoothness_of_door_actuation,
    unsafety_of_door_operation,
)
from scoring.kinematics import Array, JointState, Rows, cut_rows, joint_state, process_rows
from scoring.protocol import PASSAGE_SENSORS, Event, EventName, Signal, Thresholds
from scoring.quality import QualityCounter
from scoring.rest import FEWEST_SAMPLES, RestForce
from scoring.result import Indicator, Uncertainty, value_text
from scoring.rulesets import Ruleset
from scoring.signals import DecidingEdge, EdgeKind

# The data that values are computed from, in which doubts and uncertainties are found (section
# 11).


_NOISE = 2.0
"""A change of the largest force by fewer standard deviations of its noise is noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Grounds:
    """The evidence behind the values of a run; times in s since the epoch, rad and N.

    Attributes:
        end: of what is scored.
        door, joint, force_time, force: over the whole recording.
        impossible_angles: times of impossible door angles, shape (m,).
        guessed: stamps and angles, shape (n, 2), of passage samples that were masked before the
            door angle at their stamps had come.
        rows: cut to the run, at `rows_end`.
    """

    start: float
    end: float
    events: Sequence[Event]
    edges: Sequence[DecidingEdge]
    counters: Mapping[Signal, QualityCounter]
    door: DoorAngle
    impossible_angles: Array
    guessed: Array
    force_time: Array
    force: Array
    joint: JointState
    rows: Rows
    rows_end: float
    rest: RestForce
    handle_zero: float
    ruleset: Ruleset
    thresholds: Thresholds

    def rows_of(self, time: Array, angle: Array, ruleset: Ruleset) -> tuple[JointState, Rows]:
        """The motion of other door angles, rad, shape (n,), and the rows cut to the run."""
        joint = joint_state(time, angle, ruleset, self.thresholds)
        rows = process_rows(joint, self.force_time, self.force, ruleset, self.thresholds)
        if ruleset.cut_rows:
            rows = cut_rows(rows, self.start, self.rows_end)
        return joint, rows

    def signal_values(self) -> dict[Name, Indicator]:
        rows = self.rows
        return {
            Name.SMOOTHNESS_OF_DOOR_ACTUATION: smoothness_of_door_actuation(rows.jerk, rows.opened),
            Name.UNSAFETY_OF_DOOR_OPERATION: unsafety_of_door_operation(rows.low_passed),
            Name.ROUGHNESS_OF_DOOR_ACTUATION: roughness_of_door_actuation(rows.force),
        }

    def without_bad_samples(self) -> Grounds | None:
        """The run without bad samples and its largest force; None if next to nothing changes."""
        bad = self.door.bad
        force = without_top(self.rows.force_time, self.rows.force, self.force_noise)
        change = np.abs(self.rows.force).max(initial=0.0) - np.abs(force).max(initial=0.0)
        if not bad.any():
            if abs(change) <= _NOISE * self.force_noise:
                return None
            return replace(self, rows=replace(self.rows, force=force))
        good = np.zeros_like(bad)
        angle = self.door.without_bad()
        door = replace(self.door, angle=angle, spikes=good, frozen=good)
        joint, rows = self.rows_of(door.time, angle, self.ruleset)
        return replace(self, door=door, joint=joint, rows=replace(rows, force=force))

    @property
    def door_edges(self) -> list[float]:
        kinds = EventName.DOOR_OPENS, EventName.DOOR_CLOSES
        return [event.time for event in self.events if event.name in kinds]

    @property
    def force_noise(self) -> float:
        """Standard deviation of the free handle's force before the run, N; 0 where unknown."""
        return 0.0 if self.rest.before is None else self.rest.before.deviation


Doubt = tuple[tuple[Name, ...], str]

_MOTION = (Name.SMOOTHNESS_OF_DOOR_ACTUATION, Name.UNSAFETY_OF_DOOR_OPERATION)
_FORCE = (*EdgeKind.TOUCH.indicators, Name.ROUGHNESS_OF_DOOR_ACTUATION)
_CLOSING_TIMES = (Name.EXECUTION_TIME, Name.PASSAGE_TIME)
_FROM_START = (Name.EXECUTION_TIME, Name.TIME_TO_HANDLE)
_UNDER_SENSORS = (EdgeKind.ARRIVAL, EdgeKind.DEPARTURE)
_TOP_NOISE = 3.0
"""Noise alone lifts one force over its neighbours by up to this many standard deviations."""
_FILTER_REACH = 1.0
"""How far the filters of the door angle reach out of the run, s."""


Uncertain = Callable[[Grounds, Mapping[Name, Indicator]], Mapping[Name, Uncertainty | None]]


def all_doubts(
    grounds: Grounds, indicators: Mapping[Name, Indicator], uncertain: Uncertain
) -> dict[Name, tuple[str, ...]]:
    """The doubts on a run by indicator; `uncertain` gives uncertainties for other grounds."""
    with np.errstate(over="ignore", invalid="ignore"):  # of what only `eurobench-2020` believes
        found = (
            *edge_doubts(grounds.edges, grounds.counters, grounds.thresholds),
            *_gaps_near_edges(grounds),
            *_gaps_near_maxima(grounds),
            *_missing_samples(grounds),
            *_bad_samples(grounds, indicators, uncertain),
            *_bad_edges(grounds),
            *_impossible(grounds),
            *_guessed_angles(grounds),
            *_encoder(grounds),
            *_range_end(grounds),
            *_clipped(grounds),
            *_stuck(grounds),
            *_drift(grounds),
            *_chatter(grounds),
            *_delays(grounds),
            *_rate(grounds),
        )
    return by_indicator(found)


def by_indicator(found: Iterable[Doubt]) -> dict[Name, tuple[str, ...]]:
    """In the protocol's order, each sentence once."""
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
            rows.force,
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
    counter, intervals = g.counters.get(signal), g.thresholds.doubt.gap_intervals
    if counter is None:
        return []
    times = {Signal.DOOR: g.door.time, Signal.HANDLE: g.force_time}.get(signal)
    if times is None:
        return counter.longer_than(intervals)
    steps, usual = np.diff(times), counter.interval
    longer = np.flatnonzero(steps > intervals * usual) if usual else np.empty(0, np.intp)
    return [(float(times[i]), float(times[i + 1])) for i in longer]


def _gap_near(holes: Iterable[tuple[float, float]], time: float, reach: float) -> float | None:
    """The longest gap near a time, s; None = none."""
    near = (until - since for since, until in holes if since - reach < time < until + reach)
    return max(near, default=None)


def _open_intervals(g: Grounds) -> Array:
    is_open = np.abs(g.door.angle) > g.thresholds.closed_angle
    within = (g.door.time >= g.start) & (g.door.time <= g.end)
    counted = is_open & within
    return np.diff(g.door.time)[counted[1:] | counted[:-1]]


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


def _bad_samples(
    g: Grounds, indicators: Mapping[Name, Indicator], uncertain: Uncertain
) -> Iterator[Doubt]:
    """Samples without which a value would change by more than its uncertainty."""
    sound = g.without_bad_samples()
    if sound is None:
        return
    values = sound.signal_values()
    known = uncertain(sound, {**indicators, **values})
    words = dict.fromkeys(_MOTION, _bad_angle(g))
    words[Name.ROUGHNESS_OF_DOOR_ACTUATION] = "the largest force rests on one sample"
    for name, other in values.items():
        value, worth = indicators[name].value, known[name]
        if value is None or other.value is None or worth is None:
            continue
        noise = _TOP_NOISE * g.force_noise if name is Name.ROUGHNESS_OF_DOOR_ACTUATION else 0.0
        if abs(value - other.value) > g.thresholds.doubt.one_sample * (worth.expanded + noise):
            yield (name,), f"{words[name]}: without it {value_text(other.value, worth)}"


def _bad_angle(g: Grounds) -> str:
    times = g.door.time[g.door.bad]
    spike = f", by up to {g.door.spike:.2g} rad" if g.door.spikes.any() else ""
    return f"the door angle fits no motion{spike}, {_when(g, times)}" if times.size else ""


def _bad_edges(g: Grounds) -> Iterator[Doubt]:
    times = g.door.time[g.door.bad]
    for edge in g.edges if g.thresholds.doubt.least_readings else ():
        since = edge.time if edge.since is None else edge.since
        hangs = edge.signal is Signal.DOOR and ((times >= since) & (times <= edge.time)).any()
        if edge.kind in _UNDER_SENSORS:  # it masks them
            hangs = (np.abs(times - edge.time) <= g.thresholds.doubt.gap_reach).any()
        if hangs:
            yield edge.indicators, f"{edge.kind.words} rests on a sample that fits no motion"


def _guessed_angles(g: Grounds) -> Iterator[Doubt]:
    time, guess = g.guessed[(g.guessed[:, 0] >= g.start) & (g.guessed[:, 0] <= g.end)].T
    if not time.size or not g.door.time.size:
        return
    angle = np.interp(time, g.door.time, g.door.angle)
    differs = np.zeros(time.size, np.bool_)
    for sensor in PASSAGE_SENSORS:
        low, high = g.thresholds.mask(sensor.side, sensor.index)
        true, taken = (sensor.side.sign * each for each in (angle, guess))
        differs |= ((low < true) & (true < high)) != ((low < taken) & (taken < high))
    if differs.any():
        late = f"the door angle came too late for {int(differs.sum())} samples"
        doubted = {name: None for kind in _UNDER_SENSORS for name in kind.indicators}
        yield tuple(doubted), f"{late} of the passage sensors: they may have seen the panel"


def _encoder(g: Grounds) -> Iterator[Doubt]:
    count, limits = g.thresholds.encoder_count, g.thresholds.doubt
    most = limits.encoder * count
    for what, seen, known in (
        ("steps by", g.door.step, count),
        ("at rest varies by", g.door.noise, g.thresholds.encoder_noise),
    ):
        if seen is not None and abs(seen - known) > most:
            angles = f"{1000 * seen:.2g} mrad, not {1000 * known:.2g}"
            yield (Name.SMOOTHNESS_OF_DOOR_ACTUATION,), f"another encoder: the door {what} {angles}"


def _range_end(g: Grounds) -> Iterator[Doubt]:
    end = g.thresholds.largest_force
    if np.abs(g.rows.force).max(initial=0.0) >= g.thresholds.doubt.range_end * end:
        words = f"the load cell's range ends at {end:.0f} N: it may have been more"
        yield (Name.ROUGHNESS_OF_DOOR_ACTUATION,), words


def _impossible(g: Grounds) -> Iterator[Doubt]:
    """Impossible door angles, steps and back included, which the filters step over as a hole."""
    times = g.impossible_angles[_within_filters(g, g.impossible_angles)]
    if times.size:
        most = f"{g.thresholds.largest_angle:g} rad"
        yield _MOTION, f"the door angle is beyond {most}, which it cannot be, {_when(g, times)}"


def _within_filters(g: Grounds, times: Array) -> NDArray[np.bool_]:
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
    top = force[int(np.argmax(np.abs(force)))]
    longest = max((last - first for first, last in runs(force == top)), default=0)
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
    for first, last in runs(still):
        since, until = g.force_time[first], g.force_time[last]
        if since < g.end and until > g.start:
            longest = max(longest, float(until - since))
    if longest >= g.thresholds.doubt.stuck_time:
        yield _FORCE, f"the handle force does not change for {longest:.1f} s"


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
    """Stamps with different delays of signals that an indicator joins; the start's has none."""
    joined: dict[Name, set[Signal]] = {name: set() for name in Name}
    for edge in g.edges:
        for name in edge.kind.indicators:
            joined[name].add(edge.signal)
            if edge.kind in _UNDER_SENSORS and _may_be_masked(g, edge):
                joined[name].add(Signal.DOOR)
    for name, signals in joined.items():
        counters = (g.counters.get(s) for s in sorted(signals, key=lambda s: s.value))
        known = [
            (c.signal.value, c.delay, c.interval)
            for c in counters
            if c is not None and c.delay is not None and c.interval is not None
        ]
        if name in _FROM_START:
            known.append(("the clock of the start", 0.0, 0.0))
        for (one, delay, interval), (other, of_other, often) in combinations(known, 2):
            difference = abs(delay - of_other)
            if difference > g.thresholds.doubt.delay_intervals * max(interval, often):
                words = f"stamps of {one} and {other} differ in delay by {1000 * difference:.0f} ms"
                yield (name,), words


def _may_be_masked(g: Grounds, edge: DecidingEdge) -> bool:
    near = np.abs(g.door.time - edge.time) <= g.thresholds.doubt.gap_reach
    angles = np.abs(g.door.angle[near])
    furthest = max(g.thresholds.mask_to_cw + g.thresholds.mask_to_ccw)
    return bool(((angles > min(g.thresholds.mask_from)) & (angles < furthest)).any())


def _rate(g: Grounds) -> Iterator[Doubt]:
    counter = g.counters.get(Signal.DOOR)
    if counter is None or not counter.interval:
        return
    rate, nominal = 1 / counter.interval, g.thresholds.rate
    if not math.isclose(rate, nominal, rel_tol=0, abs_tol=g.thresholds.doubt.rate * nominal):
        words = f"the door is sampled at {rate:.1f} Hz, the testbed's rate is {nominal:g} Hz"
        yield (Name.SMOOTHNESS_OF_DOOR_ACTUATION,), words
