"""What makes a value doubtful: the nine kinds of protocol section 11, in its order.

A doubt is a sentence beside a value, one question to the referee. It never changes the value.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np

from scoring.edges import DecidingEdge, EdgeKind
from scoring.indicator_table import IndicatorName as Name
from scoring.kinematics import Array
from scoring.procedure import Evidence, Procedure
from scoring.protocol import (
    FARTHEST_ZERO,
    Condition,
    LockDetection,
    PassageSensor,
    Side,
    Signal,
    Thresholds,
)
from scoring.result import Indicator, Uncertainty, value_text
from scoring.run_info import largest_brake
from scoring.series import Flags, Series, SignalLog, Signals
from scoring.uncertainty import Recorded

_FEWEST = {EdgeKind.TOUCH: 3, EdgeKind.OPENING: 5, EdgeKind.CLOSING: 5}  # a knock opens with 3
_PAUSE = 0.1  # s; a presence goes on over it
_GAP = 0.1  # s without a new reading
_REACH = 0.2  # s; how near to an edge a hole hides another one
_FEW = 20  # samples that show no outlier
_COUNTS = 3  # by which an outlier is off
_DEVIATIONS = 5  # of the noise, likewise
_LEAST_NOISE = 0.01  # N, of a load cell
_STILL = 1.0  # s; a door does not stop so long from full speed
_LONG_STILL = 5.0  # s; noise changes a still angle sooner
_NOISY = 0.2  # of a count; such noise
_AJAR = 0.0035  # rad
_SCALE = 0.02  # of a count
_RANGE_END = 0.95  # of the load cell's range
_CLIPPED = 3  # samples at the largest force
_TOGETHER = 150  # samples whose least delay counts: a machine may stutter for a second

_MOTION = (Name.UNSAFETY_OF_DOOR_OPERATION, Name.SMOOTHNESS_OF_DOOR_ACTUATION)
_ROUGHNESS = (Name.ROUGHNESS_OF_DOOR_ACTUATION,)
_PASSING = EdgeKind.DEPARTURE.indicators
_LOCK = EdgeKind.LOCKING.indicators
_TIMES = (
    Name.EXECUTION_TIME,
    Name.TIME_TO_HANDLE,
    Name.DOOR_OCCUPATION_TIME,
    Name.PASSAGE_TIME,
)
_USES: Mapping[Signal, Sequence[Name]] = {
    **dict.fromkeys(Signal, _PASSING),
    Signal.DOOR: (*_MOTION, *EdgeKind.CLOSING.indicators),
    Signal.HANDLE: (*EdgeKind.TOUCH.indicators, *_ROUGHNESS),
    Signal.LATCH: _LOCK,
}
"""What is computed of a signal."""


class Doubt(NamedTuple):
    """A sentence that doubts indicators."""

    indicators: Sequence[Name]
    words: str


@dataclass(frozen=True, slots=True, eq=False)
class Grounds:
    """The evidence behind the values of a run; times in s since the epoch.

    Attributes:
        end: of the run; `run.rows_end` may be later.
        logs: the samples of each signal.
        presences: for each used sensor, from when to when something was under it.
        misread: words that doubt a signal, from the reader of the recording.
    """

    run: Recorded
    end: float
    condition: Condition
    handle_zero: float
    logs: Mapping[Signal, SignalLog]
    presences: Mapping[PassageSensor, Sequence[tuple[float, float]]]
    procedure: Procedure
    evidence: Evidence
    misread: Mapping[str, Signal]
    values: Mapping[Name, Indicator]
    uncertainty: Mapping[Name, Uncertainty | None]

    @property
    def edges(self) -> dict[EdgeKind, DecidingEdge]:
        return {edge.kind: edge for edge in self.run.edges}

    @property
    def needed(self) -> Signals:
        """The signals but for those that may send their changes only."""
        return {signal: s for signal, s in self.run.signals.items() if not signal.optional}

    @property
    def recorded_until(self) -> float:
        """The end of the run, or of a recording that ends earlier."""
        newest = [s.time[-1] for s in self.run.signals.values() if s.time.size]
        return min(self.run.rows_end, max(newest, default=self.run.start))

    @property
    def is_whole(self) -> bool:
        """Whether the recording has the end of the run."""
        return self.run.rows_end - self.recorded_until <= _GAP

    @property
    def is_settled(self) -> bool:
        """Whether the door's rest, as recorded, completed the run."""
        by_rest = self.procedure.lock_detection is LockDetection.SETTLE
        return self.run.completed and self.is_whole and by_rest


def doubted(grounds: Grounds) -> dict[Name, Indicator]:
    """Return the indicators with their uncertainties and doubts, each sentence once."""
    run = grounds.run
    doubts = chain(
        edge_doubts(run.edges, grounds.logs, grounds.handle_zero, run.thresholds),
        _passage(grounds),
        _hole(grounds),
        _door_outlier(grounds),
        _force_outlier(grounds),
        _freeze_for_good(grounds),
        _zero(grounds),
        _scale(grounds),
        _force_range(grounds),
        _clock(grounds),
        _publisher(grounds),
    )
    sentences = by_indicator(doubts)
    complete = {}
    for name, indicator in grounds.values.items():
        known = None if indicator.value is None else grounds.uncertainty[name]
        complete[name] = replace(indicator, uncertainty=known, doubts=sentences.get(name, ()))
    return complete


def by_indicator(doubts: Iterable[Doubt]) -> dict[Name, tuple[str, ...]]:
    """Return the sentences about each doubted indicator, each once."""
    sentences: dict[Name, dict[str, None]] = {name: {} for name in Name}
    for names, words in doubts:
        for name in names:
            sentences[name][words] = None
    return {name: tuple(words) for name, words in sentences.items() if words}


def information(grounds: Grounds) -> Iterator[str]:
    """Return what a reader of the values has to know, but nobody has to decide."""
    thresholds = grounds.run.thresholds
    end = thresholds.largest_force
    force = np.abs(grounds.run.in_run(Signal.HANDLE).value)
    if _brake_ends_range(grounds) and force.max(initial=0.0) >= _RANGE_END * end:
        yield f"handle force: at least {end:.0f} N, where the load cell's range and the brake end"
    zero = grounds.run.at_rest(Signal.DOOR)[0]
    if thresholds.near_zero < abs(zero) <= FARTHEST_ZERO:
        yield f"door angle: the closed door read {1000 * zero:+.1f} mrad before the start"


def edge_doubts(
    edges: Iterable[DecidingEdge],
    logs: Mapping[Signal, SignalLog],
    handle_zero: float,
    thresholds: Thresholds,
) -> Iterator[Doubt]:
    """Doubt a touch, opening or closing on few readings, also while the run goes on."""
    for edge in edges:
        fewest = _FEWEST.get(edge.kind, 0)  # the others may be short
        zero = 0.0
        limit = thresholds.closed_angle
        if edge.kind is EdgeKind.TOUCH:
            zero = handle_zero
            limit = thresholds.touch_force
        log = logs[edge.signal]
        at = bisect_left(log.time, edge.time)
        values = log.value[at : at + fewest]
        if edge.kind is EdgeKind.CLOSING:  # how long was it open before?
            values = log.value[max(0, at - fewest) : at][::-1]
        held = [abs(value - zero) >= limit for value in values]
        readings = [*held, False].index(False)
        if readings < fewest:
            samples = "sample" if readings == 1 else "samples"
            yield Doubt(
                edge.kind.indicators,
                f"{edge.kind.words} rests on {readings} {samples}: was it real?",
            )


def _passage(g: Grounds) -> Iterator[Doubt]:
    """Doubt an arrival or leaving that is not of the presence joining both sides."""
    spans: list[tuple[float, float, Side]] = []
    for sensor, presences in g.presences.items():
        spans += [(rise, fall, sensor.side) for rise, fall in presences if rise <= g.end]
    passages = _passages(sorted(spans))

    # nobody passed
    if not passages:
        if {EdgeKind.TOUCH, EdgeKind.OPENING, EdgeKind.CLOSING} <= g.edges.keys():
            seen = {side for _, _, side in spans}
            blind = " and ".join(side.upper() for side in Side if side not in seen)
            asked = f"are the {blind} sensors dead" if blind else "did the robot turn back"
            yield Doubt(
                _PASSING, f"the door opened and closed, but nobody was seen to pass: {asked}?"
            )
        return

    # somebody passed a closed door
    if g.run.door.time.size and EdgeKind.OPENING not in g.edges:
        yield Doubt(
            _USES[Signal.DOOR],
            "somebody passed, but the door never opened: did its sensor freeze?",
        )

    # somebody else came or left, or the robot came back to its starting side
    since, until = passages[-1]
    starting = g.condition.starting_side
    back = {fall for rise, fall, side in spans if side is starting and rise > since}
    for edge in g.run.edges:
        is_back = edge.kind is EdgeKind.DEPARTURE and edge.time in back
        if edge.kind.under_sensors and (is_back or not since <= edge.time <= until):
            yield Doubt(
                edge.kind.indicators,
                f"{edge.kind.words} is not of the passage: "
                "was somebody else there, or did the robot turn?",
            )


def _passages(spans: Sequence[tuple[float, float, Side]]) -> list[tuple[float, float]]:
    """Return from when to when somebody was under sensors of one side, then of the other.

    The spans, by time, are those in which there was somebody under one sensor.
    """
    visits: list[tuple[float, float, set[Side]]] = []
    for rise, fall, side in spans:
        if visits and rise <= visits[-1][1] + _PAUSE:
            first, last, sides = visits.pop()
            visits.append((first, max(last, fall), sides | {side}))
        else:
            visits.append((rise, fall, {side}))
    return [(first, last) for first, last, sides in visits if len(sides) > 1]


def _hole(g: Grounds) -> Iterator[Doubt]:
    """Doubt what a signal without a new reading hides. U has shorter holes."""
    run = g.run
    if not g.is_whole:
        names = list(Name)
        if EdgeKind.TOUCH in g.edges:  # a touch that was seen was the first
            names.remove(Name.TIME_TO_HANDLE)
        missing = run.rows_end - g.recorded_until
        yield Doubt(names, f"the last {missing:.1f} s of the run are not in the recording")

    for signal, series in g.needed.items():
        time = series.time
        if signal is not Signal.DOOR:  # a panel at rest says the same
            time = _new_readings(series, run.start)
        time = np.unique(np.concatenate(([run.start, g.recorded_until], time)))
        time = time[(time >= run.start) & (time <= g.recorded_until)]
        holes = [(a, b) for a, b in pairwise(time.tolist()) if b - a > _GAP]
        if holes:
            since, until = max(holes, key=lambda hole: hole[1] - hole[0])
            yield Doubt(
                _hidden_in(g, signal, holes),
                f"{signal.value}: no new reading for {until - since:.2f} s, {_when(g, since)}",
            )


def _new_readings(series: Series, start: float) -> Array:
    """Return the times of readings, s since the epoch, shape (n,).

    Of a signal with noise before the start, one that says the same again is none.
    """
    value = np.atleast_2d(series.value.T)  # one row for each range
    is_read = ~np.isnan(value).any(axis=0)
    time = series.time[is_read]
    value = value[:, is_read]
    is_new = np.ones(time.size, dtype=np.bool_)
    is_new[1:] = (value[:, 1:] != value[:, :-1]).any(axis=0)
    before = is_new[time < start]
    if before.size and before.mean() > 0.9:
        return time[is_new]
    return time


def _hidden_in(g: Grounds, signal: Signal, holes: Sequence[tuple[float, float]]) -> Sequence[Name]:
    """Return the indicators that holes of a signal may move."""
    if signal is Signal.HANDLE:
        touch = g.edges.get(EdgeKind.TOUCH)
        if touch is not None and touch.time + _REACH <= holes[0][0]:
            return _ROUGHNESS
    if signal is not Signal.DOOR:
        return _USES[signal]
    names = [*_MOTION]
    for edge in g.run.edges:
        is_near = any(a - _REACH < edge.time < b + _REACH for a, b in holes)
        if is_near and Signal.DOOR in _signals_of(edge):
            names += edge.kind.indicators
    return names


def _signals_of(edge: DecidingEdge) -> Sequence[Signal]:
    """Return the signals that make an edge: the panel masks passage sensors."""
    return (edge.signal, Signal.DOOR) if edge.kind.under_sensors else (edge.signal,)


def _when(g: Grounds, time: float) -> str:
    after = time - g.run.start
    return f"{abs(after):.1f} s {'after' if after >= 0 else 'before'} the start"


def _door_outlier(g: Grounds) -> Iterator[Doubt]:
    """Doubt a motion that curves in place of lost and bad angles move by more than its U."""
    from scipy.interpolate import CubicSpline  # slow to import, and a live run has no use for it

    if g.run.door.time.size <= _FEW:
        return
    time, angle, is_lost = _fill(g.run.door)
    is_off = _spikes(angle, _limit(g)) | _frozen(angle, _limit(g))
    is_bad = is_lost | is_off
    if not is_bad.any():
        return

    curve = CubicSpline(time[~is_bad], angle[~is_bad])(time[is_bad])
    off = np.abs(curve - angle[is_bad]).max()
    angle[is_bad] = curve
    first = _when(g, time[is_bad][0])
    words = f"{is_lost.sum()} samples of the door angle are missing (first {first})"
    if (is_off & ~is_lost).any():
        words = f"door angle jumped or froze ({off:.2g} rad, first {first})"
    for name, other in zip(_MOTION, g.run.motion(time, angle), strict=True):
        yield from _moved(g, name, other, 0.0, words)


def _fill(door: Series) -> tuple[Array, Array, Flags]:
    """Return evenly filled times and angles, and which of them were lost, each of shape (n,).

    A gap of over 0.1 s stays: a curve over it shows nothing.
    """
    steps = np.diff(door.time)
    many = np.where(steps > _GAP, 1, np.rint(steps / np.median(steps)).clip(1))
    place = np.concatenate(([0], np.cumsum(many))).astype(int)
    time = np.interp(np.arange(place[-1] + 1), place, door.time)
    is_lost = np.ones(time.size, dtype=np.bool_)
    is_lost[place] = False
    return time, np.interp(time, door.time, door.value), is_lost


def _spikes(values: Array, limit: float) -> Flags:
    """Flag values off the line through their neighbours, which are off to the other side.

    A kink, as of a slammed door, bends the curve one way only and is none.
    """
    off = np.zeros(values.size)
    off[1:-1] = values[1:-1] - (values[:-2] + values[2:]) / 2
    beside = np.maximum(off * np.roll(off, 1), off * np.roll(off, -1))
    return (np.abs(off) > limit) & (beside < -(off**2) / 4)


def _frozen(angle: Array, limit: float) -> Flags:
    """Flag a still angle before an abrupt step, by which it catches up."""
    flags = np.zeros(angle.size, dtype=np.bool_)
    steps = np.abs(np.diff(angle, prepend=angle[0]))
    for before, after in pairwise([0, *np.flatnonzero(steps).tolist()]):
        onward = steps[min(after + 1, steps.size - 1)]
        is_abrupt = steps[after] > max(limit, 2 * steps[before], 2 * onward)
        if is_abrupt and after - before > 2:
            flags[before + 1 : after] = True
    return flags


def _force_outlier(g: Grounds) -> Iterator[Doubt]:
    handle = g.run.in_run(Signal.HANDLE)
    if handle.time.size <= _FEW:
        return
    force = np.abs(handle.value)
    noise = g.run.at_rest(Signal.HANDLE)[1]
    is_single = _spikes(force, _DEVIATIONS * max(noise, _LEAST_NOISE))
    words = f"the largest force rests on one sample, {_when(g, handle.time[force.argmax()])}"
    other = float(force[~is_single].max())
    yield from _moved(g, Name.ROUGHNESS_OF_DOOR_ACTUATION, other, 3 * noise, words)


def _moved(g: Grounds, name: Name, other: float, noise: float, words: str) -> Iterator[Doubt]:
    """Doubt a value that differs from another one by more than its U and some noise."""
    value = g.values[name].value
    known = g.uncertainty[name]
    if value is not None and known is not None and abs(other - value) > known.expanded + noise:
        yield Doubt((name,), f"{words}: without it {value_text(other, known)}")


def _limit(g: Grounds) -> float:
    """Return by how much an angle is off that noise does not explain, rad."""
    return max(_COUNTS * g.run.count, _DEVIATIONS * g.run.at_rest(Signal.DOOR)[1])


def _freeze_for_good(g: Grounds) -> Iterator[Doubt]:
    """Doubt an open door that says the same to the end, from full speed or without its noise."""
    door = g.run.door
    steps = np.abs(np.diff(door.value))
    moving = np.flatnonzero(steps)
    if not moving.size or abs(door.value[-1]) < g.run.thresholds.closed_angle:
        return
    since = door.time[moving[-1] + 1]
    still = min(g.run.rows_end, door.time[-1]) - since
    from_speed = still > _STILL and steps[moving[-1]] > _limit(g)
    is_noisy = g.run.at_rest(Signal.DOOR)[1] > _NOISY * g.run.count
    if from_speed or (is_noisy and still > _LONG_STILL):
        names = [*_USES[Signal.DOOR]]
        departure = g.edges.get(EdgeKind.DEPARTURE)
        if departure is None or departure.time > since:  # the masks of the sensors stay
            names.append(Name.DOOR_OCCUPATION_TIME)
        yield Doubt(
            names,
            f"door angle does not change any more from {_when(g, since)} on: "
            "did the sensor freeze?",
        )


def _zero(g: Grounds) -> Iterator[Doubt]:
    """Doubt a closed door or a free handle off its zero, before the run or after it."""
    run = g.run
    zero, noise = run.at_rest(Signal.DOOR)
    if abs(zero) > FARTHEST_ZERO:
        yield Doubt(
            _USES[Signal.DOOR],
            f"the closed door read {1000 * zero:+.1f} mrad before the start",
        )
    if g.is_settled and run.door.time.size:
        moved = run.door.value[run.door.time > run.door.time[-1] - 0.5].mean() - zero
        if abs(moved) > _AJAR + max(noise, run.count / math.sqrt(12)):
            yield Doubt(_LOCK, f"the door rests {1000 * moved:+.0f} mrad from where it was: ajar?")

    handle = run.signals[Signal.HANDLE]
    half = run.thresholds.touch_force / 2
    if touch := g.edges.get(EdgeKind.TOUCH):
        free = handle.value[(handle.time > touch.time - 0.7) & (handle.time < touch.time - 0.2)]
        off = float(np.median(free)) - g.handle_zero if free.size else 0.0
        if abs(off) > half:
            yield Doubt(touch.kind.indicators, f"the handle read {off:+.1f} N before its touch")
    known = g.uncertainty[Name.ROUGHNESS_OF_DOOR_ACTUATION]
    if run.rest.before and run.rest.after and known:
        moved = run.rest.after.mean - run.rest.before.mean
        if abs(moved) > max(half, known.expanded):
            yield Doubt(
                _ROUGHNESS,
                f"the free handle reads {moved:+.1f} N more after the run than before: "
                "was it zeroed in between?",
            )


def _scale(g: Grounds) -> Iterator[Doubt]:
    """Doubt a door that moves in other steps than its encoder's.

    A continuous angle has none.
    """
    steps = g.run.door_steps
    usual = g.run.thresholds.encoder_count
    if steps.size <= 10 or abs(steps[2] - usual) <= _SCALE * usual:
        return
    counts = steps / steps[2]
    is_whole = np.abs(counts - np.rint(counts)) < 0.1
    if is_whole.mean() > 0.9:
        yield Doubt(
            (*_MOTION, *EdgeKind.CLOSING.indicators),
            f"the door steps by {1000 * steps[2]:.3g} mrad, not {1000 * usual:.3g}: "
            "is the encoder another one (encoder_counts)?",
        )


def _force_range(g: Grounds) -> Iterator[Doubt]:
    """Doubt a largest force where the load cell's range ends, or that is there three times."""
    if _brake_ends_range(g):
        return
    end = g.run.thresholds.largest_force
    force = np.abs(g.run.in_run(Signal.HANDLE).value)
    top = force.max(initial=0.0)
    times = (force == top).sum()
    if top >= _RANGE_END * end:
        yield Doubt(_ROUGHNESS, f"the load cell's range ends at {end:.0f} N: it may have been more")
    elif times >= _CLIPPED and top - abs(g.handle_zero) > g.run.thresholds.touch_force:
        yield Doubt(
            _ROUGHNESS, f"{times} samples have the largest force: is the load cell at its end?"
        )


def _brake_ends_range(g: Grounds) -> bool:
    return largest_brake(g.condition.benchmark_type) >= g.run.thresholds.largest_force


def _clock(g: Grounds) -> Iterator[Doubt]:
    """Doubt stamps whose delays differ by over an interval, between signals or in one."""
    intervals = [float(np.median(np.diff(s.time))) for s in g.needed.values() if s.time.size > 1]
    allowed = min(max(intervals, default=_GAP), _GAP)

    # the signals of two edges that a time joins
    counted = {signal: g.run.in_run(signal) for signal in g.run.signals}
    delays = {signal: float((s.log - s.time).min()) for signal, s in counted.items() if s.time.size}
    for name in _TIMES:
        joined = {"the start": 0.0} if name.spec.with_the_start else {}
        for edge in g.run.edges:
            if name in edge.kind.indicators:
                joined |= {s.value: delays[s] for s in _signals_of(edge) if s in delays}
        apart = max(joined.values(), default=0.0) - min(joined.values(), default=0.0)
        if apart > allowed:
            first = min(joined, key=joined.__getitem__)
            last = max(joined, key=joined.__getitem__)
            yield Doubt(
                (name,),
                f"stamps of {last} are {1000 * apart:.0f} ms later than those of {first}: "
                "do their clocks agree?",
            )

    # one signal, early and late
    for signal, series in g.needed.items():
        chunks = series.time.size // _TOGETHER
        if chunks > 1:
            parts = np.array_split(series.log - series.time, chunks)
            step = np.ptp([part.min() for part in parts])
            if step > allowed:
                words = f"{signal.value}: its clock stepped or ran away by {step:.2f} s"
                yield Doubt(_USES[signal], words)


def _publisher(g: Grounds) -> Iterator[Doubt]:
    """Doubt a signal of two publishers or misread, and an end that the recording belies."""
    run = g.run
    states = [edge.value for edge in g.evidence.latch if edge.time <= run.rows_end]
    if g.is_settled and states and not states[-1]:
        yield Doubt(_LOCK, "the latch said disengaged when the door's rest completed the run")
    elif g.is_settled and states and not g.evidence.latch_before_start:
        yield Doubt(_LOCK, "the latch spoke only after the start: the door's rest was the lock")

    for signal in run.signals:
        counted = run.in_run(signal)
        is_back = (np.diff(counted.sequence) < 0) & (counted.sequence[1:] > 0)
        if is_back.any():
            when = _when(g, counted.time[1:][is_back][0])
            words = f"{signal.value}: another publisher, or one started again, {when}"
            yield Doubt(_USES[signal], words)
    for words, signal in g.misread.items():
        yield Doubt(_USES[signal], words)

    undone = [record for record in g.procedure.steps if not record.done]
    if run.completed and g.is_whole and undone and not undone[0].denied:
        yield Doubt(
            EdgeKind.CLOSING.indicators,
            f"it ended as completed, but step {undone[0].step:d} is not in the recording",
        )
