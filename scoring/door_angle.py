"""What the door says of its encoder, and samples that fit no motion and no force (section 11)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from scoring.kinematics import Array
from scoring.protocol import Thresholds
from scoring.rest import REST_TIME

Flags = NDArray[np.bool_]

_FEWEST_STEPS = 10
"""Fewest steps of the door angle that tell its encoder's count."""

_STRAY_STEPS = 2
"""This many smaller steps may come from a bad sample."""

_SAME_STEP = 1e-9
"""Smaller steps of the door angle are none, rad."""

_AT_REST = 1.0
"""How long before the start the closed door is looked at, s."""

_COUNTS_OFF = 3
"""Encoder counts by which a sample that fits no motion is off."""

_DEVIATIONS_OFF = 5
"""Standard deviations of the door at rest by which it is off, too."""

_NEIGHBOURS = 8
"""Samples on either side that the curve in place of a bad one goes through."""

_WILD = 100.0
"""Larger angles are no neighbours, rad."""

_LEAST_NOISE = 0.01
"""A load cell has at least this much noise, N."""

_FROZEN = 2
"""Intervals without any change, in motion, that are a freeze."""

_ABRUPT = 6
"""Largest step, in counts, of a trembling panel beside a standstill."""

_TREMBLING = 0.0105
"""And in rad, however fine the counts are."""


@dataclass(frozen=True, slots=True, eq=False)
class DoorAngle:
    """The door's angle over a recording, rad; times in s since the epoch, arrays of shape (n,).

    Attributes:
        step: the smallest one; None where few are seen.
        count: of the encoder: the smallest step, at most what the settings say.
        noise: standard deviation of the closed door before the start; 0 where not known.
        before: mean of the closed door in the last second before the start; None = not known.
        after: and in the last half second of the recording.
        spikes: samples that are off their neighbours, and back.
        frozen: samples that repeat an old angle in motion.
        spike: the size of the largest spike.
    """

    time: Array
    angle: Array
    step: float | None
    count: float
    noise: float
    before: float | None
    after: float | None
    spikes: Flags
    frozen: Flags
    spike: float

    @classmethod
    def of(cls, time: Array, angle: Array, start: float, thresholds: Thresholds) -> DoorAngle:
        with np.errstate(over="ignore", invalid="ignore"):  # `eurobench-2020` believes any angle
            steps = np.abs(np.diff(angle))
            steps = steps[steps > _SAME_STEP]
            few = steps.size < _FEWEST_STEPS
            step = None if few else float(np.partition(steps, _STRAY_STEPS)[_STRAY_STEPS])
            count = min(step or math.inf, thresholds.encoder_count)
            rest = angle[(time >= start - _AT_REST) & (time < start)]
            until = time[-1] if time.size else start
            later = angle[time > max(start, until - REST_TIME)]
            before, after = (_closed_mean(each, thresholds) for each in (rest, later))
            rest = rest[np.abs(rest) < thresholds.closed_angle]
            noise = float(rest.std()) if rest.size >= _FEWEST_STEPS else 0.0
            limit = max(_COUNTS_OFF * count, _DEVIATIONS_OFF * noise)
            sizes = spike_sizes(time, angle)
            frozen = _frozen(angle, count, limit, thresholds.closed_angle)
        spike = float(sizes.max(initial=0.0))
        return cls(time, angle, step, count, noise, before, after, sizes > limit, frozen, spike)

    @property
    def bad(self) -> Flags:
        return self.spikes | self.frozen

    def repaired(self, thresholds: Thresholds) -> DoorAngle:
        """With curves through their neighbours in place of bad samples and of a few lost ones.

        The same object where there are none.
        """
        steps = np.diff(self.time)
        usual = float(np.median(steps)) if steps.size else math.inf
        short = steps <= thresholds.largest_gap
        lost = np.where(short, (np.rint(steps / usual) - 1).clip(0), 0).astype(int)
        if not (self.bad.any() or lost.any()):
            return self
        every = np.repeat(np.arange(lost.size), lost)
        number = np.arange(every.size) - np.repeat(np.cumsum(lost) - lost, lost) + 1
        between = self.time[every] + steps[every] * number / (lost[every] + 1)
        places = every + 1
        time = np.insert(self.time, places, between)
        bad = np.insert(self.bad, places, values=True)
        angle = np.insert(self.angle, places, 0.0)
        good = np.flatnonzero(~bad & (np.abs(angle) < _WILD))
        for first, last in runs(bad):
            place = int(np.searchsorted(good, first))
            near = good[max(0, place - _NEIGHBOURS) : place + _NEIGHBOURS]
            if near.size < 2 * _NEIGHBOURS or last - first > _NEIGHBOURS:
                near = good[max(0, place - 1) : place + 1]  # a line, as far as there is one
            if near.size:
                middle, degree = time[first], min(3, near.size - 1)
                curve = np.polyfit(time[near] - middle, angle[near], degree)
                angle[first:last] = np.polyval(curve, time[first:last] - middle)
        none = np.zeros_like(bad)
        return replace(self, time=time, angle=angle, spikes=none, frozen=none)


def last_closing(time: Array, angle: Array, closed: float) -> float:
    """When a door was last closed that was open before, s; inf = it is open, or never was."""
    is_open = np.flatnonzero(np.abs(angle) >= closed)
    return (
        float(time[is_open[-1] + 1]) if is_open.size and is_open[-1] + 1 < time.size else math.inf
    )


def _closed_mean(angle: Array, thresholds: Thresholds) -> float | None:
    """Of a door that rests near its zero, rad."""
    near = (
        angle[np.abs(angle - np.median(angle)) < thresholds.closed_angle] if angle.size else angle
    )
    mean = float(near.mean()) if near.size >= _FEWEST_STEPS else math.inf
    return mean if abs(mean) < 2 * thresholds.closed_angle else None


def runs(flags: Flags) -> list[tuple[int, int]]:
    """Each run of set flags: its first index, and the first after it."""
    borders = np.flatnonzero(np.diff(np.concatenate(([False], flags, [False])).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(borders[::2], borders[1::2], strict=True)]


def spike_sizes(time: Array, values: Array) -> Array:
    """By how much each value is off its neighbours and back; 0 where that is no spike's pattern.

    A spike is off the line through its neighbours, and each of these is off by half as much to
    the other side. A sudden stop, as of a slammed door, bends the curve one way only.
    """
    off = np.zeros(values.size)
    if values.size < 3:
        return off
    before, after = time[1:-1] - time[:-2], time[2:] - time[1:-1]
    line = (values[:-2] * after + values[2:] * before) / (before + after)
    off[1:-1] = values[1:-1] - line
    sign = np.sign(off)
    sizes = np.abs(off)
    sizes[1:] = np.minimum(sizes[1:], -2 * sign[1:] * off[:-1])
    sizes[:-1] = np.minimum(sizes[:-1], -2 * sign[:-1] * off[1:])
    return np.where(sizes > np.abs(off) / 2, sizes, 0.0)


def without_spikes(time: Array, force: Array, noise: float) -> Array:
    """Sizes of forces, N, shape (n,), with curves in place of spikes.

    `noise` is the standard deviation of the force at rest, N. A knock rises and falls over several
    samples and is no spike.
    """
    size = np.abs(force)
    spikes = spike_sizes(time, force) > _DEVIATIONS_OFF * max(noise, _LEAST_NOISE)
    return _bridged(size, np.flatnonzero(spikes))


def _bridged(size: Array, places: NDArray[np.intp]) -> Array:
    bridged = size.copy()
    bridged[places] = 0.0
    inner = places[(places >= 2) & (places < size.size - 2)]
    far, left, right, away = (size[inner + step] for step in (-2, -1, 1, 2))
    highest = np.maximum(np.maximum(left, right), np.minimum(2 * left - far, 2 * right - away))
    bridged[inner] = np.minimum((4 * (left + right) - far - away) / 6, highest)
    return bridged


def _frozen(angle: Array, count: float, limit: float, closed: float) -> Flags:
    """An angle that stands still between steps too large for a panel that is, or will be, open.

    It stops and goes on by over a count, or catches up by far more than the steps beside it.
    """
    frozen = np.zeros(angle.size, np.bool_)
    steps = np.diff(angle)
    moves = [-1, *np.flatnonzero(steps != 0)]
    for last, following in pairwise(moves):
        still, jump = following - last - 1, abs(steps[following])
        if still < _FROZEN or max(abs(angle[following]), abs(angle[following + 1])) < closed:
            continue
        before = abs(steps[last]) if last >= 0 else 0.0
        onward = abs(steps[following + 1]) if following + 1 < steps.size else 0.0
        abrupt = min(before, jump) > max(_ABRUPT * count, _TREMBLING)
        if abrupt or (jump > limit and jump > 2 * max(before, onward)):
            frozen[last + 2 : following + 1] = True
    return frozen
