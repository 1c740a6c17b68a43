"""What makes a value doubtful: few samples behind an edge, gaps, spikes, drift (section 11).

A doubt is a sentence beside a value. It never changes one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scoring.deciding_edges import DecidingEdge, EdgeKind
from scoring.door_angle import runs
from scoring.grounds import Grounds
from scoring.indicator_table import IndicatorName as Name
from scoring.kinematics import Array
from scoring.protocol import (
    FARTHEST_ZERO,
    PASSAGE_SENSORS,
    LockDetection,
    Side,
    Signal,
    Strip,
    Thresholds,
)
from scoring.quality import QualityCounter
from scoring.rest import FEWEST_SAMPLES
from scoring.result import Indicator, Uncertainty, value_text
from scoring.signals import edges_until

Doubt = tuple[tuple[Name, ...], str]

_MOTION = (Name.SMOOTHNESS_OF_DOOR_ACTUATION, Name.UNSAFETY_OF_DOOR_OPERATION)
_FORCE = (*EdgeKind.TOUCH.indicators, Name.ROUGHNESS_OF_DOOR_ACTUATION)
_SETTLED = (Name.EXECUTION_TIME, Name.CAPABILITY_LEVEL)
_PASSING = tuple(dict.fromkeys(EdgeKind.ARRIVAL.indicators + EdgeKind.DEPARTURE.indicators))
_CLOSING_TIMES = (Name.EXECUTION_TIME, Name.PASSAGE_TIME)
_FROM_START = (Name.EXECUTION_TIME, Name.TIME_TO_HANDLE)
_UNDER_SENSORS = (EdgeKind.ARRIVAL, EdgeKind.DEPARTURE)
_TOP_NOISE = 3.0
"""Noise alone lifts one force over its neighbours by up to this many standard deviations."""
_UNDECIDABLE = "arrival and leaving cannot be decided"

_BY_CHANCE = 1e-6
_UNEVEN = 0.01
"""The stamps' jitter makes accelerations differ by less than this part of them."""
_LATCH_SILENT = 0.5
"""A latch sensor that spoke all the time is silent after this, s."""
_SAME_SCALE = 0.02
"""Encoders whose steps differ by less, as a part of them, have the same scale."""
LONGEST_SHIFT = 0.5
"""An edge that an unsure zero may move by more is doubted; up to this its U has it, s."""
_FILTER_REACH = 1.0
"""How far the filters of the door angle reach out of the run, s."""

Uncertain = Callable[[Grounds, Mapping[Name, Indicator]], Mapping[Name, Uncertainty | None]]


def all_doubts(
    grounds: Grounds,
    indicators: Mapping[Name, Indicator],
    uncertainty: Mapping[Name, Uncertainty | None],
    uncertain: Uncertain,
) -> dict[Name, tuple[str, ...]]:
    """The doubts on a run by indicator; `uncertain` gives uncertainties for other grounds."""
    with np.errstate(over="ignore", invalid="ignore"):  # of what only `eurobench-2020` believes
        doubts = (
            *edge_doubts(grounds.edges, grounds.counters, grounds.thresholds),
            *_other_visits(grounds),
            *_blind_strips(grounds),
            *_gaps(grounds),
            *_missing_samples(grounds),
            *_bad_samples(grounds, indicators, uncertain),
            *_bad_edges(grounds),
            *_impossible(grounds),
            *_guessed_angles(grounds),
            *_encoder(grounds),
            *_door_zero(grounds),
            *_range_end(grounds),
            *_stuck(grounds),
            *_uneven(grounds, indicators, uncertainty),
            *_latch(grounds),
            *_unfinished(grounds),
            *_drift(grounds),
            *_chatter(grounds),
            *_newcomers(grounds),
            *_delays(grounds),
            *_rate(grounds),
            *_misread(grounds),
        )
    return by_indicator(doubts)


def by_indicator(doubts: Iterable[Doubt]) -> dict[Name, tuple[str, ...]]:
    """In the protocol's order, each sentence once."""
    sentences: dict[Name, dict[str, None]] = {name: {} for name in Name}
    for names, words in doubts:
        for name in names:
            sentences[name][words] = None
    return {name: tuple(words) for name, words in sentences.items() if words}


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
            alone = f"one passage strip for {1000 * edge.alone:.0f} ms"
            yield edge.indicators, f"{edge.kind.words} rests on {alone}"


def _other_visits(g: Grounds) -> Iterator[Doubt]:
    """An arrival or a leaving of somebody who did not pass from one side to the other."""
    passages = [
        visit
        for visit in _visits(g, frozenset(Side))
        if len(visit.sides) > 1 and visit.rise <= g.end
    ]
    here = [visit.fall for visit in _visits(g, {g.condition.starting_side}) if visit.rise <= g.end]
    for edge in g.edges if passages else ():
        passage = passages[-1]
        # the robot was on the other side when something ended the run on this one
        again = any(passage.rise <= fall < edge.time for fall in here) and edge.time in here
        passed = passage.rise <= edge.time <= passage.fall and not again
        if edge.kind in _UNDER_SENSORS and not passed:
            words = (
                f"something was under the sensors twice, {edge.kind.words} is not of what passed"
            )
            yield edge.indicators, words


class _Visit(NamedTuple):
    """A presence under any sensors of some sides, pauses included; s since the epoch."""

    rise: float
    fall: float
    sides: frozenset[Side]


def _visits(g: Grounds, of: Container[Side]) -> list[_Visit]:
    visits: list[_Visit] = []
    under = (
        (rise, fall, s.side) for s, presences in g.presences.items() for rise, fall in presences
    )
    for rise, fall, side in sorted(each for each in under if each[2] in of):
        if visits and rise <= visits[-1].fall + g.thresholds.largest_gap:
            before = visits.pop()
            visits.append(_Visit(before.rise, max(before.fall, fall), before.sides | {side}))
        else:
            visits.append(_Visit(rise, fall, frozenset({side})))
    return visits


def _blind_strips(g: Grounds) -> Iterator[Doubt]:
    for strip in Strip:
        counter = g.counters.get(signal := Signal.of_strip(strip))
        if counter is None:
            yield _PASSING, f"{signal.value}: nothing recorded: {_UNDECIDABLE}"
        elif counter.no_reading > (readings := counter.readings) / 2:
            share = f"{100 * counter.no_reading / readings:.0f} of 100 values without a reading"
            yield _PASSING, f"{signal.value}: {share}: {_UNDECIDABLE}"
    seen_sides = {sensor.side for sensor, presences in g.presences.items() if presences}
    if {EdgeKind.TOUCH, EdgeKind.OPENING, EdgeKind.CLOSING} <= {edge.kind for edge in g.edges}:
        for side in set(Side) - seen_sides:
            arrives = side is g.condition.starting_side
            words = f"the door was opened and closed, but the {side.upper()} sensors saw nothing"
            yield (EdgeKind.ARRIVAL if arrives else EdgeKind.DEPARTURE).indicators, words


def _gaps(g: Grounds) -> Iterator[Doubt]:
    """Holes of a signal near what decides, one sentence for each signal."""
    rows, limits = g.rows, g.thresholds.doubt
    motion = rows.joint_state.time, rows.low_passed, limits.filter_reach
    force = rows.force_time, rows.force, limits.gap_reach
    holes = {signal: _holes(g, signal) for signal in Signal}
    near: list[tuple[Signal, float | None, str, tuple[Name, ...]]] = []
    for name, signal, times, values, reach, words in (
        (Name.UNSAFETY_OF_DOOR_OPERATION, Signal.DOOR, *motion, "the largest acceleration"),
        (Name.ROUGHNESS_OF_DOOR_ACTUATION, Signal.HANDLE, *force, "the largest force"),
    ):
        if np.isfinite(values).any():
            at = float(times[int(np.nanargmax(np.abs(values)))])
            near.append((signal, _gap_near(holes[signal], at, reach), words, (name,)))
    for signal in set(Signal) - {Signal.DOOR, Signal.LATCH}:
        cut = [(max(a, g.start), min(b, g.end)) for a, b in holes[signal]]
        long = [(a, b) for a, b in cut if b - a > g.thresholds.largest_gap]
        if long:
            hidden = _PASSING
            if signal is Signal.HANDLE:  # a touch in it would have been the first
                before = min(a for a, _ in long)
                touched = {edge.kind for edge in g.edges if edge.time <= before}
                hidden = _computed_of(signal, touched)
            near.append((signal, max(b - a for a, b in long), "", hidden))
    for edge in g.edges:
        # where the panel is decides which passage sensors it masks
        for signal in {edge.signal, Signal.DOOR} if edge.kind in _UNDER_SENSORS else {edge.signal}:
            gap = _gap_near(holes[signal], edge.time, limits.gap_reach)
            near.append((signal, gap, edge.kind.words, edge.indicators))
    for signal in Signal:
        gaps = [(gap, w, names) for of, gap, w, names in near if of is signal and gap is not None]
        if gaps:
            places = " and ".join(dict.fromkeys(words for _, words, _ in gaps if words))
            where = f"near {places}" if places else "of the run"
            longest = max(gap for gap, *_ in gaps)
            names = dict.fromkeys(name for *_, doubted in gaps for name in doubted)
            yield tuple(names), f"{signal.value}: no reading for {longest:.3f} s {where}"


def _holes(g: Grounds, signal: Signal) -> list[tuple[float, float]]:
    counter, intervals = g.counters.get(signal), g.thresholds.doubt.gap_intervals
    if counter is None:
        return []
    holes = counter.longer_than(intervals) + counter.stills()
    recorded = min(g.end, g.recorded_until)
    if (usual := counter.interval) and recorded - counter.read_until > intervals * usual:
        holes.append((counter.read_until, recorded))
    times = {Signal.DOOR: g.door.time, Signal.HANDLE: g.force_time}.get(signal)
    if times is not None and usual:  # readings that are none leave one, too
        longer = np.flatnonzero(np.diff(times) > intervals * usual)
        holes += [(float(times[i]), float(times[i + 1])) for i in longer]
        first = float(times[0]) if times.size else recorded
        if first - g.start > intervals * usual:
            holes.append((g.start, first))
    return holes


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
    """Samples without which a value would change by more than its uncertainty, lost ones too."""
    sound = g.without_bad_samples()
    if sound is None:
        return
    values = sound.signal_values()
    of_sound = uncertain(sound, {**indicators, **values})
    words = dict.fromkeys(_MOTION, _bad_angle(g))
    words[Name.ROUGHNESS_OF_DOOR_ACTUATION] = "the largest force rests on one sample"
    for name, other in values.items():
        value, worth = indicators[name].value, of_sound[name]
        if value is None or other.value is None or worth is None:
            continue
        noise = _TOP_NOISE * g.force_noise if name is Name.ROUGHNESS_OF_DOOR_ACTUATION else 0.0
        if abs(value - other.value) > g.thresholds.doubt.one_sample * (worth.expanded + noise):
            yield (name,), f"{words[name]}: without it {value_text(other.value, worth)}"


def _bad_angle(g: Grounds) -> str:
    times = g.door.time[g.door.bad]
    if not times.size:
        return "samples of the door angle are missing"
    spike = f", by up to {g.door.spike:.2g} rad" if g.door.spikes.any() else ""
    return f"the door angle fits no motion{spike}, {_when(g, times)}"


def _bad_edges(g: Grounds) -> Iterator[Doubt]:
    times = g.door.time[g.door.bad]
    for edge in g.edges:
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
        yield _PASSING, f"{late} of the passage sensors: they may have seen the panel"


def _encoder(g: Grounds) -> Iterator[Doubt]:
    count, limits = g.thresholds.encoder_count, g.thresholds.doubt
    scaled = (*_MOTION, *EdgeKind.CLOSING.indicators)
    for names, what, measured, usual, most in (
        (scaled, "steps by", g.door.step, count, _SAME_SCALE * count),
        (
            _MOTION[:1],
            "at rest varies by",
            g.door.noise,
            g.thresholds.encoder_noise,
            limits.encoder * count,
        ),
    ):
        if measured is not None and abs(measured - usual) > most:
            angles = f"{1000 * measured:.3g} mrad, not {1000 * usual:.3g}"
            yield names, f"another encoder: the door {what} {angles}"


def _door_zero(g: Grounds) -> Iterator[Doubt]:
    """A zero that is far off or decides whether the door closed, and a door that rests ajar."""
    before, after = g.door.before, g.door.after
    if before is None:
        return
    if abs(before) > FARTHEST_ZERO or g.zero_shift() == math.inf:
        words = f"the closed door read {1000 * before:+.1f} mrad before the start"
        yield _computed_of(Signal.DOOR), words
    settled = g.completed and g.procedure.lock_detection is LockDetection.SETTLE
    if not settled or after is None:
        return
    least_noise = g.thresholds.encoder_count / math.sqrt(12)  # of its steps
    if abs(after - before) > g.thresholds.near_zero + max(g.door.noise, least_noise):
        rests = f"the door rests at {1000 * after:+.0f} mrad, before the start at"
        yield _SETTLED, f"{rests} {1000 * before:+.0f}: ajar?"


def information(g: Grounds) -> Iterator[str]:
    """What a reader of the values has to know, but nobody has to decide."""
    if g.brake_ends_range and g.force_ends_range:
        end = g.thresholds.largest_force
        yield f"handle force: at least {end:.0f} N, where the load cell's range and the brake end"
    if g.door.before is not None and 0 < (shift := g.zero_shift()) < math.inf:
        moves = f"this moves execution and passage time by {shift:.2f} s"
        yield f"door angle: the closed door read {1000 * g.door.before:+.1f} mrad, {moves}"


def _range_end(g: Grounds) -> Iterator[Doubt]:
    """A force at the end of what the load cell can say, or clipped, where the brake is weaker."""
    force = g.rows.force
    if g.brake_ends_range or not force.size:
        return
    top = force[int(np.argmax(np.abs(force)))]
    longest = max((last - first for first, last in runs(force == top)), default=0)
    pressed = abs(top - g.handle_zero) > g.thresholds.touch_force
    if g.force_ends_range:
        end = f"{g.thresholds.largest_force:.0f} N: it may have been more"
        yield (Name.ROUGHNESS_OF_DOOR_ACTUATION,), f"the load cell's range ends at {end}"
    elif pressed and longest >= g.thresholds.doubt.clipped:
        words = f"the largest force stands still for {longest} samples: clipped"
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


def _stuck(g: Grounds) -> Iterator[Doubt]:
    still = np.diff(g.force) == 0
    at_rest = still[g.force_time[1:] < g.start]
    if at_rest.size < FEWEST_SAMPLES or at_rest.mean() >= 0.5:
        return  # its steps are coarser than its noise
    # so many equal samples in a row come by chance in fewer than one run of a thousand
    fewest = max(2.0, math.log(_BY_CHANCE) / math.log(max(float(at_rest.mean()), _BY_CHANCE)))
    stretches = [
        (last - first, float(g.force_time[last] - g.force_time[first]))
        for first, last in runs(still)
        if g.force_time[first] < g.end and g.force_time[last] > g.start
    ]
    count, longest = max(stretches, default=(0, 0.0))
    if count >= fewest:
        yield _FORCE, f"the handle force does not change for {longest:.2f} s"


def _uneven(
    g: Grounds,
    indicators: Mapping[Name, Indicator],
    uncertainty: Mapping[Name, Uncertainty | None],
) -> Iterator[Doubt]:
    """Another rate about the largest acceleration: its filters take the mean of all intervals."""
    name, counter = Name.UNSAFETY_OF_DOOR_OPERATION, g.counters.get(Signal.DOOR)
    value, worth, every = indicators[name].value, uncertainty[name], g.joint.time
    if value is None or worth is None or counter is None or not counter.interval:
        return
    at = g.rows.joint_state.time[int(np.nanargmax(np.abs(g.rows.low_passed)))]
    intervals = np.diff(every[np.abs(every - at) <= g.thresholds.doubt.filter_reach])
    local = float(intervals[intervals <= g.thresholds.largest_gap].mean())
    if abs((counter.interval / local) ** 2 - 1) * value > max(worth.expanded, _UNEVEN * value):
        rates = f"{1 / local:.1f} Hz near the largest acceleration, else {1 / counter.interval:.1f}"
        yield (name,), f"the door is sampled at {rates}"


def _latch(g: Grounds) -> Iterator[Doubt]:
    """A latch sensor that the door contradicts, that spoke too late, or that fell silent."""
    if g.completed and g.procedure.lock_detection is LockDetection.SETTLE:
        states = g.evidence.latch[: edges_until(g.evidence.latch, g.rows_end)]
        if states and not states[-1].value:
            yield _SETTLED, "the latch said disengaged when the door's rest completed the run"
        elif states and not g.evidence.latch_before_start:
            yield _SETTLED, "the latch spoke only after the start: the door's rest was the lock"
    counter, unlocking = g.counters.get(Signal.LATCH), g.procedure.steps[1]
    if g.procedure.lock_detection is not LockDetection.SENSOR or counter is None:
        return
    opened = {EdgeKind.TOUCH, EdgeKind.OPENING} <= {edge.kind for edge in g.edges}
    if opened and unlocking.sensors is None:
        words = "the door opened, but the latch sensor never said that it was unlocked"
        yield EdgeKind.CLOSING.indicators, words
    silent = min(g.end, g.recorded_until) - counter.read_until
    if counter.interval and silent > _LATCH_SILENT:
        yield EdgeKind.CLOSING.indicators, f"latch: silent in the last {silent:.1f} s of the run"


def _unfinished(g: Grounds) -> Iterator[Doubt]:
    undone = [step for step in g.procedure.steps if not step.done]
    if g.completed and g.recorded_until >= g.end and undone and not undone[0].denied:
        words = f"it ended as completed, but step {undone[0].step:d} is not in the recording"
        yield EdgeKind.CLOSING.indicators, words


def _drift(g: Grounds) -> Iterator[Doubt]:
    drift, most = g.rest.drift, g.thresholds.doubt.drift * g.thresholds.touch_force
    if drift is not None and abs(drift) > most and g.drift_shift() > LONGEST_SHIFT:
        words = f"the handle at rest after the run is {drift:+.2f} N off its zero"
        yield EdgeKind.TOUCH.indicators, words


def _chatter(g: Grounds) -> Iterator[Doubt]:
    times, allowed = g.door_edges, g.thresholds.doubt.chatter
    within = zip(times, times[allowed:], strict=False)
    if any(last - first <= 1.0 for first, last in within):
        yield _CLOSING_TIMES, f"the door opens and closes more than {allowed} times within a second"


def _newcomers(g: Grounds) -> Iterator[Doubt]:
    """Values of a signal that a second publisher sent, too."""
    for signal, counter in g.counters.items():
        since = next((t for t in counter.restarts if g.start <= t <= g.rows_end), None)
        if since is None:
            continue
        settled = {edge.kind for edge in g.edges if edge.signal is signal and edge.time < since}
        when = f"from {since - g.start:.2f} s after the start on"
        words = f"{signal.value}: another publisher, or one started again, {when}"
        yield _computed_of(signal, settled), words


def _computed_of(signal: Signal, settled: Container[EdgeKind] = ()) -> tuple[Name, ...]:
    """The indicators of a signal, except those whose edges are already settled."""
    kinds = [kind for kind in EdgeKind if signal in kind.signals and kind not in settled]
    names = {Signal.DOOR: _MOTION, Signal.HANDLE: _FORCE[-1:]}.get(signal, ())
    return (*names, *(name for kind in kinds for name in kind.indicators))


def _delays(g: Grounds) -> Iterator[Doubt]:
    """Stamps with different delays of signals that an indicator joins; the start's has none."""
    joined: dict[Name, set[tuple[Signal, float]]] = {name: set() for name in Name}
    for edge in g.edges:
        masked = edge.kind in _UNDER_SENSORS and _may_be_masked(g, edge)
        for name in edge.indicators:
            joined[name].add((edge.signal, edge.time))
            joined[name] |= {(Signal.DOOR, edge.time)} if masked else set()
    largest: dict[str, float] = {}
    doubted: dict[str, list[Name]] = {}
    for name, edges in joined.items():
        delays = [("the clock of the start", 0.0, 0.0)] if name in _FROM_START else []
        for signal, time in sorted(edges, key=lambda edge: (edge[0].value, edge[1])):
            counter = g.counters.get(signal)
            delay = None if counter is None else counter.delay_near(time)
            if counter is not None and delay is not None and counter.interval is not None:
                delays.append((signal.value, delay, counter.interval))
        for (first, delay, interval), (second, of_other, often) in combinations(delays, 2):
            difference = abs(delay - of_other)
            if difference > g.thresholds.doubt.delay_intervals * max(interval, often):
                between = (
                    f"{second} and {first}" if first != second else f"{first}, early and late,"
                )
                largest[between] = max(difference, largest.get(between, 0.0))
                doubted.setdefault(between, []).append(name)
    for between, difference in largest.items():
        words = f"stamps of {between} differ in delay by {1000 * difference:.0f} ms"
        yield tuple(doubted[between]), words


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


def _misread(g: Grounds) -> Iterator[Doubt]:
    for words, signal in g.doubted.items():
        yield _computed_of(signal), words
