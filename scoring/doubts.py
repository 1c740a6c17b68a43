"""What makes a value doubtful: nine kinds, each one question to the referee (section 11).

A doubt is a sentence beside a value. It never changes one.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from scoring.edges import DecidingEdge, EdgeKind
from scoring.indicator_table import IndicatorName as Name
from scoring.kinematics import Array
from scoring.procedure import Evidence, Procedure
from scoring.protocol import (
    FARTHEST_ZERO,
    PASSAGE_SENSORS,
    Condition,
    LockDetection,
    PassageSensor,
    Side,
    Signal,
    Thresholds,
)
from scoring.result import Indicator, Uncertainty, value_text
from scoring.run_info import largest_brake
from scoring.series import Flags, Series, SignalLog
from scoring.uncertainty import Recorded

Doubt = tuple[tuple[Name, ...], str]

_GAP = 0.1  # s without a new reading
_REACH = 0.2  # s; how near to an edge a hole hides another one
_PAUSE = 0.1  # s; a presence goes on over it
_FEWEST = {EdgeKind.TOUCH: 3, EdgeKind.OPENING: 5, EdgeKind.CLOSING: 5}  # a knock opens with 3
_COUNTS, _DEVIATIONS = 3, 5  # by which a bad angle is off
_TREMBLING = 0.0105  # rad a sample: no panel that trembles does more
_STILL = 1.0  # s; a door does not stop so long from full speed
_NOISY, _LONG_STILL = 0.2, 5.0  # of a count, s; such noise changes a still angle sooner
_FROZEN = 50  # samples of a freeze at most
_LEAST_NOISE = 0.01  # N, of a load cell
_AJAR = 0.0035  # rad
_SCALE = 0.02  # of a count
_RANGE_END = 0.95  # of the load cell's range
_CLIPPED = 3  # samples at the largest force
_TOGETHER = 150  # the least delay of so many samples counts: a machine may stutter for a second
_NEAR = 1.5  # s; delays about an edge

_MOTION = (Name.UNSAFETY_OF_DOOR_OPERATION, Name.SMOOTHNESS_OF_DOOR_ACTUATION)
_ROUGHNESS = (Name.ROUGHNESS_OF_DOOR_ACTUATION,)
_PASSING = (
    Name.EXECUTION_TIME,
    Name.DOOR_OCCUPATION_TIME,
    Name.PASSAGE_TIME,
    Name.CAPABILITY_LEVEL,
)
_TOUCHING = (*EdgeKind.TOUCH.indicators, *_ROUGHNESS)
_SETTLED = EdgeKind.LOCKING.indicators
_OF_SIGNAL: Mapping[Signal, tuple[Name, ...]] = {
    Signal.DOOR: (*_MOTION, *EdgeKind.CLOSING.indicators),
    Signal.HANDLE: _TOUCHING,
    Signal.LATCH: _SETTLED,
}
"""What is computed of a signal; of a strip, what depends on who passes."""


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
    def thresholds(self) -> Thresholds:
        return self.run.thresholds

    @property
    def kinds(self) -> dict[EdgeKind, DecidingEdge]:
        return {edge.kind: edge for edge in self.run.edges}

    @property
    def recorded_until(self) -> float:
        newest = [s.time[-1] for s in self.run.signals.values() if s.time.size]
        return float(max(newest, default=-math.inf))

    @property
    def missing_end(self) -> float:
        """How much of the run the recording lacks at its end, s."""
        return self.run.rows_end - self.recorded_until

    @property
    def settled(self) -> bool:
        """Whether the door's rest, as recorded, completed the run."""
        if self.missing_end > _GAP:
            return False
        return self.run.completed and self.procedure.lock_detection is LockDetection.SETTLE


def doubted(grounds: Grounds) -> dict[Name, Indicator]:
    """Return the indicators with their uncertainties and doubts, each sentence once."""
    rules: tuple[Callable[[Grounds], Iterator[Doubt]], ...] = (
        _few_readings,
        _other_visits,
        _torn_end,
        _holes,
        _outliers,
        _freeze,
        _zeros,
        _scale,
        _range_end,
        _clocks,
        _latch,
        _publishers,
    )
    with np.errstate(invalid="ignore"):  # ranges without an echo are infinite
        doubts = by_indicator(doubt for rule in rules for doubt in rule(grounds))
    complete = {}
    for name, indicator in grounds.values.items():
        worth = None if indicator.value is None else grounds.uncertainty[name]
        complete[name] = replace(indicator, uncertainty=worth, doubts=doubts.get(name, ()))
    return complete


def by_indicator(doubts: Iterable[Doubt]) -> dict[Name, tuple[str, ...]]:
    sentences: dict[Name, dict[str, None]] = {name: {} for name in Name}
    for names, words in doubts:
        for name in names:
            sentences[name][words] = None
    return {name: tuple(words) for name, words in sentences.items() if words}


def information(g: Grounds) -> Iterator[str]:
    """Return what a reader of the values has to know, but nobody has to decide."""
    if _brake_ends_range(g) and _top_force(g)[0] >= _RANGE_END * g.thresholds.largest_force:
        end = g.thresholds.largest_force
        yield f"handle force: at least {end:.0f} N, where the load cell's range and the brake end"
    zero = g.run.at_rest(Signal.DOOR)[0]
    if g.thresholds.near_zero < abs(zero) <= FARTHEST_ZERO:
        yield f"door angle: the closed door read {1000 * zero:+.1f} mrad before the start"


# --- edges


def _few_readings(g: Grounds) -> Iterator[Doubt]:
    yield from edge_doubts(g.run.edges, g.logs, g.handle_zero, g.thresholds)


def edge_doubts(
    edges: Iterable[DecidingEdge],
    logs: Mapping[Signal, SignalLog],
    handle_zero: float,
    thresholds: Thresholds,
) -> Iterator[Doubt]:
    """Doubt a touch, opening or closing on few readings, also while the run goes on."""
    for edge in edges:
        fewest, log = _FEWEST.get(edge.kind, 0), logs[edge.signal]
        zero, limit = 0.0, thresholds.closed_angle
        if edge.kind is EdgeKind.TOUCH:
            zero, limit = handle_zero, thresholds.touch_force
        at = bisect_left(log.time, edge.time)
        held = [abs(value - zero) >= limit for value in log.value[at : at + fewest]]
        state = edge.kind is not EdgeKind.CLOSING
        readings = (*held, not state).index(not state)
        if edge.kind is EdgeKind.CLOSING:  # it was open before
            before = [abs(value) >= limit for value in log.value[max(0, at - fewest) : at]]
            readings = min(readings, (*reversed(before), False).index(False))
        if readings < fewest:
            counted = f"{readings} sample{'s' if readings != 1 else ''}"
            yield edge.kind.indicators, f"{edge.kind.words} rests on {counted}: was it real?"


def _other_visits(g: Grounds) -> Iterator[Doubt]:
    """Doubt an arrival or leaving that is not of the presence joining both sides."""
    visits: list[tuple[float, float, set[Side]]] = []
    under = [(a, b, s.side) for s, spans in g.presences.items() for a, b in spans if a <= g.end]
    for rise, fall, side in sorted(under):
        if visits and rise <= visits[-1][1] + _PAUSE:
            first, last, sides = visits.pop()
            visits.append((first, max(last, fall), sides | {side}))
        else:
            visits.append((rise, fall, {side}))
    passages = [visit for visit in visits if len(visit[2]) > 1]
    if not passages:
        if {EdgeKind.TOUCH, EdgeKind.OPENING, EdgeKind.CLOSING} <= g.kinds.keys():
            seen = {side for _, _, sides in visits for side in sides}
            blind = " and ".join(side.upper() for side in Side if side not in seen)
            asked = f"are the {blind} sensors dead" if blind else "did the robot turn back"
            yield _PASSING, f"the door opened and closed, but nobody was seen to pass: {asked}?"
        return
    if g.run.door.time.size and EdgeKind.OPENING not in g.kinds:
        words = "somebody passed, but the door never opened: did its sensor freeze?"
        yield _OF_SIGNAL[Signal.DOOR], words
    since, until, _ = passages[-1]
    starting = g.condition.starting_side
    # the robot was on the other side when something ended the run on this one
    back = {b for a, b, side in under if side is starting and since < a and b <= g.end}
    for edge in g.run.edges:
        again = edge.kind is EdgeKind.DEPARTURE and edge.time in back
        if edge.kind.under_sensors and (again or not since <= edge.time <= until):
            words = f"{edge.kind.words} is not of the passage"
            yield edge.kind.indicators, f"{words}: was somebody else there, or did the robot turn?"


# --- what is missing


def _torn_end(g: Grounds) -> Iterator[Doubt]:
    if g.missing_end > _GAP:
        # a touch that was seen was the first
        seen = [Name.TIME_TO_HANDLE] if EdgeKind.TOUCH in g.kinds else []
        names = tuple(name for name in Name if name not in seen)
        yield names, f"the last {g.missing_end:.1f} s of the run are not in the recording"


def _holes(g: Grounds) -> Iterator[Doubt]:
    """Doubt what a signal without a new reading hides. U has shorter holes."""
    for signal, series in g.run.signals.items():
        if signal.optional:  # it may send its changes only
            continue
        whole = signal in (Signal.DOOR, Signal.HANDLE)
        until = min(g.run.rows_end if whole else g.end, g.recorded_until)
        read = _new_readings(series, -math.inf if signal is Signal.DOOR else g.run.start)
        first, last = min([g.run.start, *read[:1]]), max([until, *read[-1:]])
        times = np.concatenate(([first], read, [last]))
        long = (np.diff(times) > _GAP) & (times[1:] > g.run.start) & (times[:-1] < until)
        holes = [*zip(times[:-1][long], times[1:][long], strict=True)]
        names = _hidden_in(g, signal, holes)
        if names:
            longest = max(b - a for a, b in holes)
            words = f"{signal.value}: no new reading for {longest:.2f} s"
            yield names, f"{words}, {_when(g, max(holes, key=lambda hole: hole[1] - hole[0])[0])}"


def _hidden_in(
    g: Grounds, signal: Signal, holes: Sequence[tuple[float, float]]
) -> tuple[Name, ...]:
    """The indicators that a hole of a signal may move."""
    if not holes:
        return ()
    names = list(_MOTION if signal is Signal.DOOR else _PASSING)
    if signal is Signal.HANDLE:
        touch = g.kinds.get(EdgeKind.TOUCH)
        is_before = touch is None or holes[0][0] < touch.time  # an earlier touch may lie in it
        names = list(_TOUCHING if is_before else _ROUGHNESS)
    for edge in g.run.edges:
        masks = signal is Signal.DOOR and edge.kind.under_sensors and _is_open(g, edge.time)
        if signal is edge.signal or masks:
            near = any(a - _REACH < edge.time < b + _REACH for a, b in holes)
            names += edge.kind.indicators if near else ()
    return tuple(dict.fromkeys(names))


def _new_readings(series: Series, start: float) -> Array:
    """Return the times of readings, (n,).

    Of a signal with noise, one that says the same again is none.
    """
    if not series.time.size:
        return series.time
    value = series.value.reshape(series.time.size, -1)
    is_read = ~np.isnan(value).any(axis=1)
    time, value = series.time[is_read], value[is_read]
    if not time.size:
        return time
    is_new = np.concatenate(([True], (value[1:] != value[:-1]).any(axis=1)))
    before = is_new[time < start]
    return time[is_new] if before.size and before.mean() > 0.9 else time


def _is_open(g: Grounds, time: float) -> bool:
    door = g.run.door
    if not door.time.size:
        return False
    return abs(float(np.interp(time, door.time, door.value))) > g.thresholds.closed_angle


# --- outliers


def _outliers(g: Grounds) -> Iterator[Doubt]:
    """Doubt a value that curves in place of lost and bad samples move by more than its U."""
    door, limit = g.run.door, _limit(g)
    if door.time.size > 20:
        repaired = Repaired(door.time, door.value, limit)
        if repaired.bad.any():
            others = g.run.motion(repaired.grid, repaired.angle)
            for name, other in zip(_MOTION, others, strict=True):
                yield from _moved(g, name, other, 0.0, repaired.words(g.run.start))
    handle = g.run.signals[Signal.HANDLE]
    inside = (handle.time >= g.run.start) & (handle.time <= g.run.rows_end)
    size = np.abs(handle.value[inside])
    if size.size > 20:
        noise = g.run.at_rest(Signal.HANDLE)[1]
        single = spikes(size, _DEVIATIONS * max(noise, _LEAST_NOISE))
        top = float(np.where(single, 0.0, size).max())
        when = _when(g, handle.time[inside][int(size.argmax())])
        words = f"the largest force rests on one sample, {when}"
        yield from _moved(g, _ROUGHNESS[0], top, 3 * noise, words)


def _moved(g: Grounds, name: Name, other: float, noise: float, words: str) -> Iterator[Doubt]:
    value, worth = g.values[name].value, g.uncertainty[name]
    if value is not None and worth is not None and abs(other - value) > worth.expanded + noise:
        yield (name,), f"{words}: without it {value_text(other, worth)}"


def _limit(g: Grounds) -> float:
    return max(_COUNTS * g.run.count, _DEVIATIONS * g.run.at_rest(Signal.DOOR)[1])


def _when(g: Grounds, time: float) -> str:
    after = float(time) - g.run.start
    return f"{abs(after):.1f} s {'after' if after >= 0 else 'before'} the start"


class Repaired:
    """A door angle with curves in place of what is lost, off and back, or frozen in motion.

    Attributes:
        grid, angle: evenly filled times, s since the epoch, and angles, rad, shape (n,).
        bad: which of them are curves.
    """

    def __init__(self, time: Array, angle: Array, limit: float) -> None:
        from scipy.interpolate import CubicSpline

        steps = np.diff(time)
        many = np.where(steps > _GAP, 1, np.rint(steps / np.median(steps)).clip(1))
        place = np.concatenate(([0], np.cumsum(many))).astype(int)
        self.grid = np.interp(np.arange(place[-1] + 1), place, time)
        self.angle = np.interp(self.grid, time, angle)
        self._lost = np.ones(self.grid.size, dtype=np.bool_)
        self._lost[place] = False
        self.spikes = spikes(self.angle, limit)
        self.bad = self._lost | self.spikes | frozen(self.angle, limit)
        self.off = 0.0
        if self.bad.any():
            good = ~self.bad
            curve = CubicSpline(self.grid[good], self.angle[good])(self.grid[self.bad])
            self.off = float(np.abs(curve - self.angle[self.bad]).max())
            self.angle[self.bad] = curve

    def words(self, start: float) -> str:
        """Return what is bad: how many, by how much, and when it was first."""
        first = float(self.grid[self.bad][0]) - start
        when = f"{abs(first):.1f} s {'after' if first >= 0 else 'before'} the start"
        if (self.bad & ~self._lost).any():
            return f"door angle jumped or froze ({self.off:.2g} rad, first {when})"
        return f"{self._lost.sum()} samples of the door angle are missing (first {when})"


def spikes(values: Array, limit: float) -> Flags:
    """Values off the line through their neighbours, which are off by a quarter to the other side.

    A kink, as of a slammed door, bends the curve one way only and is none.
    """
    off = np.zeros(values.size)
    off[1:-1] = values[1:-1] - (values[:-2] + values[2:]) / 2
    beside = np.zeros(values.size)
    beside[1:-1] = np.minimum(-np.sign(off[1:-1]) * off[:-2], -np.sign(off[1:-1]) * off[2:])
    return (np.abs(off) > limit) & (beside > np.abs(off) / 4)


def frozen(angle: Array, limit: float) -> Flags:
    """Flag a still angle between two abrupt steps, or before one that catches up."""
    flags = np.zeros(angle.size, dtype=np.bool_)
    steps = np.abs(np.diff(angle))
    for before, after in pairwise([-1, *np.flatnonzero(steps).tolist()]):
        still, into = after - before - 1, steps[before] if before >= 0 else 0.0
        onward = steps[min(after + 1, steps.size - 1)]
        is_abrupt = min(into, steps[after]) > max(2 * limit, _TREMBLING)
        catches_up = steps[after] > max(limit, 2 * into, 2 * onward)
        if (still >= 1 and is_abrupt) or (still >= 2 and catches_up):
            # a door that was closed for long froze just before
            flags[max(before + 2, after - _FROZEN) : after + 1] = True
    return flags


def _freeze(g: Grounds) -> Iterator[Doubt]:
    """Doubt an open door that says the same to the end, from full speed or without its noise."""
    door = g.run.door
    moves = np.flatnonzero(np.diff(door.value))
    if not moves.size or abs(door.value[-1]) < g.thresholds.closed_angle:
        return
    last = moves[-1]
    still = min(g.run.rows_end, door.time[-1]) - door.time[last + 1]
    stopped = still > _STILL and abs(door.value[last + 1] - door.value[last]) > _limit(g)
    is_noisy = g.run.at_rest(Signal.DOOR)[1] > _NOISY * g.run.count
    if stopped or (is_noisy and still > _LONG_STILL):
        words = f"door angle does not change any more from {_when(g, door.time[last + 1])} on"
        names = _OF_SIGNAL[Signal.DOOR]
        angle, left = float(door.value[-1]), g.kinds.get(EdgeKind.DEPARTURE)
        is_masked = any(g.thresholds.masked(s.side, s.index, angle) for s in PASSAGE_SENSORS)
        if is_masked and (left is None or left.time > door.time[last + 1]):
            names = (*names, Name.DOOR_OCCUPATION_TIME)  # the sensors stay masked
        yield names, f"{words}: did the sensor freeze?"


# --- zeros, scale, range


def _zeros(g: Grounds) -> Iterator[Doubt]:
    """Doubt a closed door or free handle off its zero, and a door that rests elsewhere."""
    run, door = g.run, g.run.door
    zero, noise = run.at_rest(Signal.DOOR)
    if abs(zero) > FARTHEST_ZERO:
        words = f"the closed door read {1000 * zero:+.1f} mrad before the start"
        yield _OF_SIGNAL[Signal.DOOR], words
    if g.settled and door.time.size:
        rest = float(door.value[door.time > door.time[-1] - 0.5].mean())
        if abs(rest - zero) > _AJAR + max(noise, run.count / math.sqrt(12)):
            words = f"the door rests {1000 * (rest - zero):+.0f} mrad from where it was: ajar?"
            yield _SETTLED, words
    handle, drift = run.signals[Signal.HANDLE], run.rest.drift
    half = g.thresholds.touch_force / 2
    if (touch := g.kinds.get(EdgeKind.TOUCH)) is not None:
        free = handle.value[(handle.time > touch.time - 0.7) & (handle.time < touch.time - 0.2)]
        off = float(np.median(free)) - g.handle_zero if free.size else 0.0
        if abs(off) > half:
            yield EdgeKind.TOUCH.indicators, f"the handle read {off:+.1f} N before its touch"
    worth = g.uncertainty[_ROUGHNESS[0]]
    if drift is not None and worth is not None and run.rest.before is not None:
        moved = drift - (run.rest.before.mean - g.handle_zero)
        if abs(moved) > max(half, worth.expanded):
            words = f"the free handle reads {moved:+.1f} N more after the run than before"
            yield _ROUGHNESS, f"{words}: was it zeroed in between?"


def _scale(g: Grounds) -> Iterator[Doubt]:
    """Doubt a door that moves in other steps than its encoder's.

    A continuous angle has none.
    """
    steps = np.abs(np.diff(g.run.door.value))
    steps = np.sort(steps[steps > 1e-9])
    usual = g.thresholds.encoder_count
    if steps.size <= 10 or abs(steps[2] - usual) <= _SCALE * usual:
        return
    counts = steps / steps[2]
    if (np.abs(counts - np.rint(counts)) < 0.1).mean() > 0.9:
        words = f"the door steps by {1000 * steps[2]:.3g} mrad, not {1000 * usual:.3g}"
        names = (*_MOTION, *EdgeKind.CLOSING.indicators)
        yield names, f"{words}: is the encoder another one (encoder_counts)?"


def _top_force(g: Grounds) -> tuple[float, int]:
    """The largest force of the run, N, and how many samples have it."""
    handle = g.run.signals[Signal.HANDLE]
    size = np.abs(handle.value[(handle.time >= g.run.start) & (handle.time <= g.run.rows_end)])
    top = float(size.max(initial=0.0))
    return top, int((size == top).sum())


def _brake_ends_range(g: Grounds) -> bool:
    return largest_brake(g.condition.benchmark_type) >= g.thresholds.largest_force


def _range_end(g: Grounds) -> Iterator[Doubt]:
    """Doubt a largest force where the load cell's range ends, or that is there three times."""
    top, times = _top_force(g)
    is_clipped = times >= _CLIPPED and top - abs(g.handle_zero) > g.thresholds.touch_force
    if _brake_ends_range(g):
        return
    if top >= _RANGE_END * g.thresholds.largest_force:
        end = g.thresholds.largest_force
        yield _ROUGHNESS, f"the load cell's range ends at {end:.0f} N: it may have been more"
    elif is_clipped:
        yield _ROUGHNESS, f"{times} samples have the largest force: is the load cell at its end?"


# --- clocks, latch, publishers


def _clocks(g: Grounds) -> Iterator[Doubt]:
    """Doubt times whose edges were stamped with delays that differ by over an interval."""
    run = g.run
    needed = [s for signal, s in run.signals.items() if s.time.size > 1 and not signal.optional]
    intervals = [float(np.median(np.diff(series.time))) for series in needed]
    allowed = min(max(intervals, default=_GAP), _GAP)
    apart: dict[str, list[Name]] = {}
    for name in (
        Name.EXECUTION_TIME,
        Name.TIME_TO_HANDLE,
        Name.DOOR_OCCUPATION_TIME,
        Name.PASSAGE_TIME,
    ):
        delays = _delays(g, name)
        first = min(delays, key=delays.__getitem__, default=None)
        last = max(delays, key=delays.__getitem__, default=None)
        if first is None or last is None or delays[last] - delays[first] <= allowed:
            continue
        difference = 1000 * (delays[last] - delays[first])
        words = f"stamps of {last} are {difference:.0f} ms later than those of {first}"
        apart.setdefault(f"{words}: do their clocks agree?", []).append(name)
    for words, names in apart.items():
        yield tuple(names), words
    for signal, series in run.signals.items():
        late = series.log - series.time
        whole = late[: late.size // _TOGETHER * _TOGETHER].reshape(-1, _TOGETHER)
        least = whole.min(axis=1)
        if least.size and not signal.optional and np.ptp(least) > allowed:
            words = f"{signal.value}: its clock stepped or ran away by {np.ptp(least):.2f} s"
            yield _OF_SIGNAL.get(signal, _PASSING), words


def _delays(g: Grounds, name: Name) -> dict[str, float]:
    """Return how far reception lies behind the stamps, s, about each edge that a time joins."""
    with_start = name.spec.with_the_start
    delays = {"the start": 0.0} if with_start else {}
    for edge in g.run.edges:
        if name not in edge.kind.indicators:
            continue
        masks = edge.kind.under_sensors and _is_open(g, edge.time)
        for signal in {edge.signal, Signal.DOOR} if masks else {edge.signal}:
            series = g.run.signals[signal]
            near = np.abs(series.time - edge.time) < _NEAR
            if near.any():
                least = float((series.log - series.time)[near].min())
                delays[signal.value] = max(least, delays.get(signal.value, -math.inf))
    return delays


def _latch(g: Grounds) -> Iterator[Doubt]:
    """Doubt a lock by the door's rest where the latch said otherwise, or spoke too late."""
    if not g.settled:
        return
    states = [edge for edge in g.evidence.latch if edge.time <= g.run.rows_end]
    if states and not states[-1].value:
        yield _SETTLED, "the latch said disengaged when the door's rest completed the run"
    elif states and not g.evidence.latch_before_start:
        yield _SETTLED, "the latch spoke only after the start: the door's rest was the lock"


def _publishers(g: Grounds) -> Iterator[Doubt]:
    """Doubt a signal of two publishers or misread, and a completion that lacks a step."""
    for signal, series in g.run.signals.items():
        back = np.flatnonzero((np.diff(series.sequence) < 0) & (series.sequence[1:] > 0)) + 1
        times = [t for t in series.time[back] if g.run.start <= t <= g.run.rows_end]
        if times:
            words = f"{signal.value}: another publisher, or one started again, {_when(g, times[0])}"
            yield _OF_SIGNAL.get(signal, _PASSING), words
    for words, signal in g.misread.items():
        yield _OF_SIGNAL.get(signal, _PASSING), words
    undone = [step for step in g.procedure.steps if not step.done]
    is_whole = g.missing_end <= _GAP  # else that is the cause
    if g.run.completed and is_whole and undone and not undone[0].denied:
        words = f"it ended as completed, but step {undone[0].step:d} is not in the recording"
        yield EdgeKind.CLOSING.indicators, words
