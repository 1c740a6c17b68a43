"""The uncertainty of the values, by Monte Carlo (section 11, JCGM 101).

Each draw is an error: what a sensor that samples at other instants, with other noise, makes of
the motion that was seen, less that motion. First come errors of times, then of the motion and of
the force. The draws are the same each time: their seed is a digest of the recorded samples.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from scoring.deciding_edges import DecidingEdge, EdgeKind
from scoring.doubts import LONGEST_SHIFT
from scoring.grounds import Grounds
from scoring.indicator_table import IndicatorName as Name
from scoring.indicators import SMOOTHNESS_SCALE
from scoring.kinematics import (
    Array,
    JointState,
    jerk_rows,
    low_pass,
    low_pass_response,
    noise_kernel,
    other_windows,
    smoothed,
)
from scoring.protocol import Event, EventName, Signal
from scoring.result import Indicator, Uncertainty
from scoring.rulesets import Ruleset

DRAWS = 200

_HELD = 0.98
"""The expanded uncertainty holds this part of the drawn errors: 95 in 100 of all."""

_TRIED = 8

_MOST_PEAKS = 48

_NEAR_TOP = 0.9
"""Forces from this part of the largest on can be the largest in a draw."""

_MOST_TOPS = 1024

_LONGEST_COUNT = 0.5
"""A panel that takes longer for one count stands still, s."""

_NUDGE = 1e-3
"""An edge is moved by this to see which times depend on it, s."""

_LONG_KERNEL = 64
"""Rows of a kernel from which on a Fourier transform is quicker."""

_LEAST_JITTER = 1e-5
"""Less jitter of the stamps moves nothing, s: their resolution is 238 ns."""

_HIDDEN = 3.0
"""Noise may hide the largest value where it is lower by this many standard deviations."""

_MOTION = (Name.SMOOTHNESS_OF_DOOR_ACTUATION, Name.UNSAFETY_OF_DOOR_OPERATION)
Values = Mapping[Name, Indicator]


def uncertainties(
    grounds: Grounds, indicators: Values, times: Callable[[Sequence[Event]], Values]
) -> dict[Name, Uncertainty | None]:
    """The uncertainty of every indicator; None = not known, 0 for the level alone."""
    random = np.random.RandomState(_seed(grounds))  # its stream is frozen, unlike a Generator's
    with np.errstate(over="ignore", invalid="ignore"):
        errors = _motion(grounds, indicators, random)
        errors[Name.ROUGHNESS_OF_DOOR_ACTUATION] = _roughness(grounds, random)
        spreads = {name: _spread(drawn) for name, drawn in errors.items()}
    exact = {Name.CAPABILITY_LEVEL: Uncertainty(0.0, 0.0)}
    if (force := spreads[Name.ROUGHNESS_OF_DOOR_ACTUATION]) is not None:
        rests = [
            stretch.mean
            for stretch in (grounds.rest.before, grounds.rest.after)
            if stretch is not None
        ]
        rest = _two_digits(max(rests, key=abs, default=0.0))
        spreads[Name.ROUGHNESS_OF_DOOR_ACTUATION] = replace(force, rest=rest)
    return dict.fromkeys(Name) | spreads | _times(grounds, indicators, times) | exact


def _seed(grounds: Grounds) -> list[int]:
    digest = hashlib.blake2b(digest_size=16)
    # as recorded: `rows.force` may be without bad samples
    of_run = np.searchsorted(grounds.force_time, grounds.rows.force_time)
    for series in (grounds.door.time, grounds.door.angle, grounds.force[of_run]):
        digest.update(np.ascontiguousarray(series).tobytes())
    return [int(word) for word in np.frombuffer(digest.digest(), dtype=np.uint32)]


def _spread(errors: Array) -> Uncertainty | None:
    """Root mean square of the errors, and the size that holds them; both about the value."""
    finite = np.abs(errors[np.isfinite(errors)])
    if not finite.size:
        return None
    u, expanded = float(np.sqrt(np.square(finite).mean())), float(np.quantile(finite, _HELD))
    if not math.isfinite(u):  # of forces and angles that only `eurobench-2020` believes
        return None
    return Uncertainty(_two_digits(u), _two_digits(expanded))


def _two_digits(value: float) -> float:
    return float(f"{value:.1e}")


def _spread_evenly(random: np.random.RandomState, columns: int) -> Array:
    """Numbers in [0, 1), shape (DRAWS, columns), by a Latin hypercube."""
    places = np.array([random.permutation(DRAWS) for _ in range(columns)]).reshape(columns, DRAWS)
    shares: Array = (places.T + random.random_sample((DRAWS, columns))) / DRAWS
    return shares


def _times(
    grounds: Grounds, indicators: Values, times: Callable[[Sequence[Event]], Values]
) -> dict[Name, Uncertainty | None]:
    """In closed form, from the edges on which each time depends."""
    events = list(_looked_at(grounds.events))
    errors: dict[Name, list[_EdgeError]] = {name: [] for name in times(events)}
    for edge in grounds.edges:
        moved = [replace(e, time=e.time - _NUDGE * (e.time == edge.time)) for e in events]
        for name, other in times(moved).items() if edge.since is not None else ():
            value = indicators[name].value
            if value is not None and other.value is not None and value != other.value:
                errors[name].append(_EdgeError.of(grounds, edge, later=value > other.value))
    by_hand = grounds.start_uncertainty
    uncertainty: dict[Name, Uncertainty | None] = {}
    for name, parts in errors.items():
        mean, deviation = sum(p.mean for p in parts), math.hypot(*(p.deviation for p in parts))
        most, shift = sum(p.most for p in parts), sum(p.shift for p in parts)
        start = by_hand if name.spec.with_the_start else 0.0
        u = math.hypot(mean, deviation, shift / math.sqrt(3), start / 2)
        expanded = min(abs(mean) + 2 * deviation, _HELD * most) + shift
        uncertainty[name] = Uncertainty(_two_digits(u), _two_digits(math.hypot(expanded, start)))
    return uncertainty


@dataclass(frozen=True, slots=True)
class _EdgeError:
    """The error of a time by one of its edges, s; `shift` is a zero's, which may be off or not."""

    mean: float
    deviation: float
    most: float
    shift: float

    @classmethod
    def of(cls, grounds: Grounds, edge: DecidingEdge, *, later: bool) -> _EdgeError:
        """It lies between its sample and the one before, of stamps behind the start's clock.

        A door edge's angle is off by up to half a count of the encoder.
        """
        late, counted = edge.time - (edge.since or edge.time), _time_of_a_count(grounds, edge)
        behind = _known_delay(grounds, edge)
        counter = grounds.counters.get(edge.signal)
        jitter = (counter.jitter or 0.0) if counter is not None else 0.0
        shift = 0.0
        if edge.kind is EdgeKind.TOUCH:
            shift = grounds.drift_shift()
        elif edge.kind is EdgeKind.CLOSING:
            shift = grounds.zero_shift()
        return cls(
            mean=(late - behind) / 2 * (1 if later else -1),
            deviation=math.hypot(late, counted, behind, jitter) / math.sqrt(12),
            most=late + counted / 2 + abs(behind) + jitter,
            shift=shift if shift < LONGEST_SHIFT else 0.0,
        )


def _known_delay(grounds: Grounds, edge: DecidingEdge) -> float:
    """How far an edge's stamps lie behind the clock of the start, s, at most an interval."""
    counter = grounds.counters.get(edge.signal)
    delay = None if counter is None else counter.delay_near(edge.time)
    if counter is None or delay is None or counter.interval is None:
        return 0.0
    return max(-counter.interval, min(counter.interval, delay))


def _time_of_a_count(grounds: Grounds, edge: DecidingEdge) -> float:
    if edge.signal is not Signal.DOOR or not grounds.joint.time.size:
        return 0.0
    row = int(np.searchsorted(grounds.joint.time, edge.time).clip(0, grounds.joint.time.size - 1))
    speed = abs(float(grounds.joint.velocity[row]))
    return min(grounds.door.count / speed, _LONGEST_COUNT) if speed > 0 else 0.0


def _looked_at(events: Sequence[Event]) -> Iterator[Event]:
    """The events that indicators use; a flickering door makes thousands of others."""
    last = {event.name: event for event in events}
    for name, event in last.items():
        if name is not EventName.DOOR_OPENS:
            yield event


def _motion(
    grounds: Grounds, indicators: Values, random: np.random.RandomState
) -> dict[Name, Array]:
    """The same motion, sampled at other instants by an encoder at another position."""
    joint, ruleset, thresholds = grounds.joint, grounds.ruleset, grounds.thresholds
    kernel = noise_kernel(joint, ruleset, thresholds)
    window = grounds.rows.joint_state.time
    if kernel is None or not window.size:
        return {}
    smooth = smoothed(joint, ruleset, thresholds)
    low_passed = low_pass(smooth, ruleset, thresholds)
    first, last = (int(row) for row in np.searchsorted(joint.time, (window[0], window[-1])))
    response = low_pass_response(joint, ruleset, thresholds, kernel)
    reach = max(kernel.size, response.size) + 1
    part = slice(max(0, first - reach), min(joint.time.size, last + reach + 1))
    after = _jerks_in(grounds, smooth, first, last)
    change_of_noise = np.convolve(kernel, (1, -1))
    convolve = (
        np.convolve if kernel.size < _LONG_KERNEL else import_module("scipy.signal").oaconvolve
    )
    later = after - part.start + kernel.size // 2  # in a full convolution
    intervals = joint.time[after] - joint.time[after - 1]

    def quotients(noise: Array) -> Array:
        jerks: Array = convolve(noise, change_of_noise)[later] / intervals
        return jerks

    jerk = (smooth.acceleration[after] - smooth.acceleration[after - 1]) / intervals
    lost = (joint.acceleration[after] - joint.acceleration[after - 1]) / intervals - jerk
    phases = _spread_evenly(random, 2)
    tried = islice(_angle_errors(grounds, smooth, part, phases, random), _TRIED)
    jerk += _share_of_motion(lost, [quotients(error) for error in tried]) * lost
    size = np.nan_to_num(np.abs(low_passed))
    tops = _peaks(size[first : last + 1]) + first
    signs, curve = np.sign(np.nan_to_num(low_passed[tops])), _Curve.through(size, tops)
    near = tops[:, None] - part.start + np.arange(response.size)[::-1] - response.size // 2
    near = near.clip(0, part.stop - part.start - 1)
    drawn = np.full((2, DRAWS), np.nan)
    noise = np.zeros((DRAWS, tops.size))
    for draw, error in enumerate(_angle_errors(grounds, smooth, part, phases, random)):
        jerks = np.abs(jerk + quotients(error))
        if jerks.size and (mean := float(jerks.mean())):
            drawn[0, draw] = SMOOTHNESS_SCALE / mean
        noise[draw] = error[near] @ response
    defined = drawn[0, np.isfinite(drawn[0])]
    drawn[0] -= defined.sum() / max(1, defined.size)  # no error: what encoder and noise always add
    with_noise = (
        signs * curve.under_noise(phases[:, :1], float(noise.std()) if tops.size else 0.0) + noise
    )
    drawn[1] = np.abs(with_noise).max(axis=1, initial=0.0) - curve.top
    for others in _alternatives(grounds, indicators):
        drawn += others[:, random.randint(0, others.shape[1], DRAWS)]
    return dict(zip(_MOTION, drawn, strict=True))


def _alternatives(grounds: Grounds, indicators: Values) -> Iterator[Array]:
    """Differences of smoothness and unsafety for each chance decision, shape (2, 2), first 0."""
    time, angle, rules = grounds.door.time, grounds.door.angle, grounds.ruleset
    if (other := other_windows(grounds.joint.time, rules)) is not None:
        yield _differences(grounds, indicators, time, angle, other)
    between = (time[1:] + time[:-1]) / 2, (angle[1:] + angle[:-1]) / 2
    halfway = _differences(grounds, indicators, *between, rules)  # where a sudden stop lies
    halfway[0] = 0.0
    yield halfway


def _differences(
    grounds: Grounds, indicators: Values, time: Array, angle: Array, rules: Ruleset
) -> Array:
    differences = np.zeros((2, 2))
    others = replace(grounds, rows=grounds.rows_of(time, angle, rules)[1]).signal_values()
    for row, name in enumerate(_MOTION):
        value, other = indicators[name].value, others[name]
        if value is not None and other.value is not None:
            differences[row, 1] = other.value - value
    return differences


def _share_of_motion(lost: Array, noises: Sequence[Array]) -> float:
    """The part of the jerk lost to smoothing that is motion, so that trembling is not smooth."""
    power = float(np.square(lost).sum())
    noise = sum(float(np.square(each).sum()) for each in noises) / len(noises)
    return math.sqrt(max(0.0, 1 - noise / power)) if power else 0.0


def _jerks_in(grounds: Grounds, smooth: JointState, first: int, last: int) -> NDArray[np.intp]:
    """The later rows of the run's difference quotients that can be jerk; shape (m,)."""
    before, after = jerk_rows(grounds.joint, grounds.ruleset, grounds.thresholds)
    is_usable = (after >= first) & (after <= last) & (before == after - 1)
    is_defined = np.isfinite(smooth.acceleration)
    is_usable &= is_defined[after] & is_defined[before]
    return np.compress(is_usable, after)


def _angle_errors(
    grounds: Grounds,
    smooth: JointState,
    part: slice,
    phases: Array,
    random: np.random.RandomState,
) -> Iterator[Array]:
    """For each draw, the encoder's reading of a smooth motion less the motion, rad, shape (rows,).

    A slow panel stays on one encoder step for several samples. So each draw samples the motion a
    part of an interval later, with the encoder a part of a count further on. The stamps' jitter
    adds uniform noise, the closed door's own noise is normal.
    """
    count, trembling = grounds.door.count, grounds.door.noise
    intervals = np.diff(grounds.door.time)
    regular = intervals[intervals <= grounds.thresholds.largest_gap]
    interval = float(regular.mean()) if regular.size else 0.0
    jitter = float(regular.std()) / math.sqrt(2) if regular.size else 0.0
    angle, speed = smooth.position[part], np.nan_to_num(grounds.joint.velocity[part])
    for phase, begins in phases:  # one by one: they stay in the cache
        moved = angle + interval * phase * speed + count * begins
        shown = moved + trembling * random.standard_normal(angle.size) if trembling else moved
        error: Array = np.rint(shown / count) * count - moved
        if jitter > _LEAST_JITTER:
            noise = random.random_sample(error.size) - 0.5
            error += math.sqrt(12) * jitter * speed * noise
        yield error


def _tops(size: Array, most: int) -> NDArray[np.intp]:
    """Places of the largest sizes that are not 0, in an order that all libraries give."""
    nonzero = np.flatnonzero(size > 0)
    return np.sort(nonzero[np.argsort(-size[nonzero], kind="stable")[:most]])


def _peaks(size: Array) -> NDArray[np.intp]:
    """Where the largest peaks begin: each lies within an interval after one of them."""
    padded = np.pad(size, 1)
    peaks = _tops(np.where((size >= padded[:-2]) & (size >= padded[2:]), size, 0.0), _MOST_PEAKS)
    return np.unique(np.concatenate((peaks, (peaks - 1).clip(0))))


@dataclass(frozen=True, slots=True, eq=False)
class _Curve:
    """Parabolas between samples with the smaller curvature of both ends: no overshoot at a step."""

    heights: Array
    rises: Array
    bends: Array

    @classmethod
    def through(cls, size: Array, places: NDArray[np.intp]) -> _Curve:
        bent = np.zeros(size.size)
        bent[1:-1] = 2 * size[1:-1] - size[:-2] - size[2:]
        here = places.clip(0, size.size - 1)
        following = (places + 1).clip(0, size.size - 1)
        bends = np.minimum(bent[here], bent[following]).clip(0)
        return cls(size[here], size[following] - size[here], bends)

    def at(self, part: float | Array) -> Array:
        between: Array = self.heights + part * self.rises + self.bends * part * (1 - part) / 2
        return between

    def under_noise(self, part: Array, noise: float | Array) -> Array:
        """The curve raised by what noise of a standard deviation may hide, at most to its top."""
        return np.minimum(self.at(part) + _HIDDEN * noise, self.top)

    @property
    def top(self) -> float:
        with np.errstate(divide="ignore"):
            highest = (self.rises / self.bends + 0.5).clip(0, 1)
        parts = np.where(self.bends > 0, highest, self.rises > 0)
        return float(self.at(parts).max(initial=0.0))


def _roughness(grounds: Grounds, random: np.random.RandomState) -> Array:
    size, noise = np.abs(grounds.rows.force), grounds.force_noise
    if not size.size:
        return np.full(DRAWS, np.nan)
    tops = _tops(np.where(size >= _NEAR_TOP * size.max(), size, 0.0), _MOST_TOPS)
    curve = _Curve.through(size, tops)
    phases = _spread_evenly(random, 1)
    freedom = max(1, grounds.rest.before.number - 1) if grounds.rest.before else 1
    few = np.sqrt(freedom / random.chisquare(freedom, (DRAWS, 1)))  # samples tell the noise
    forces = curve.under_noise(phases, few * noise)
    forces += few * noise * random.standard_normal(forces.shape)
    errors: Array = np.abs(forces).max(axis=1, initial=0.0) - curve.top
    return errors
