"""How far the values can be trusted: their uncertainty, by Monte Carlo (section 11, JCGM 101).

What is drawn: when an edge happened between two samples, the door angle within an encoder count
and the jitter of its stamps, the force's noise, and where the samples lie about a force peak. The
draws are the same each time: their seed is a digest of the recorded samples.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from scoring.deciding import DecidingEdge
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
    smoothed,
)
from scoring.protocol import Event, EventName, Signal
from scoring.result import Indicator, Uncertainty

DRAWS = 100
"""Draws of each value."""

_FEWEST_STEPS = 10
"""Steps of the door angle that tell its encoder's count."""

_TRIED = 8
"""Draws that tell how much jerk encoder and stamps add."""

_NEAR_TOP = 0.9
"""Forces from this part of the largest on can be the largest in a draw."""

_MOST_TOPS = 48
"""So many of the largest values are drawn."""

_SAME_STEP = 1e-9
"""Smaller steps of the door angle are none, rad."""

_LONGEST_COUNT = 0.5
"""A panel that takes longer for one count stands still, s."""

_LEAST_JITTER = 1e-5
"""Less jitter of the stamps moves nothing, s: they are known to 238 ns."""


def uncertainties(
    grounds: Grounds, times: Callable[[Sequence[Event]], Mapping[Name, Indicator]]
) -> dict[Name, Uncertainty | None]:
    """The uncertainty of every indicator; 0 where nothing that is drawn moves it.

    None where it is beyond the range of numbers.

    Args:
        grounds: what the values rest on.
        times: the time indicators of other events.
    """
    random = np.random.RandomState(_seed(grounds))  # its stream is frozen, unlike a Generator's
    with np.errstate(over="ignore", invalid="ignore"):
        draws = {
            **_times(grounds, times, random),
            **_motion(grounds, random),
            Name.ROUGHNESS_OF_DOOR_ACTUATION: _roughness(grounds, random),
        }
        return {name: _spread(draws.get(name)) for name in Name}


def _seed(grounds: Grounds) -> list[int]:
    """From all samples: the same for the same recording, whatever reads it."""
    digest = hashlib.blake2b(digest_size=16)
    for series in (grounds.door_time, grounds.door_angle, grounds.rows.force):
        digest.update(np.ascontiguousarray(series).tobytes())
    return [int(word) for word in np.frombuffer(digest.digest(), dtype=np.uint32)]


def _spread(draws: Array | None) -> Uncertainty | None:
    finite = np.empty(0) if draws is None else draws[np.isfinite(draws)]
    u = float(finite.std(ddof=1)) if finite.size > 1 else 0.0
    if not math.isfinite(2 * u):  # of forces and angles that only `eurobench-2020` believes
        return None
    return Uncertainty(_two_digits(u), _two_digits(2 * u))


def _two_digits(value: float) -> float:
    return float(f"{value:.1e}")


# ---------------------------------------------------------------------------------- times


def _times(
    grounds: Grounds,
    times: Callable[[Sequence[Event]], Mapping[Name, Indicator]],
    random: np.random.RandomState,
) -> dict[Name, Array]:
    """Each edge happened somewhere between its sample and the one before.

    One of the door did so at an angle that is off by up to half an encoder count, too.
    """
    timed = [edge for edge in grounds.edges if edge.since is not None]
    widths = np.array([edge.time - (edge.since or edge.time) for edge in timed])
    counted = np.array([_time_of_a_count(grounds, edge) for edge in timed])
    events = list(_looked_at(grounds.events))
    draws: dict[Name, list[float]] = {}
    shares = random.random_sample((2, DRAWS, len(timed)))
    for shifts in shares[0] * widths + (shares[1] - 0.5) * counted:
        of_time = {edge.time: float(by) for edge, by in zip(timed, shifts, strict=True)}
        moved = [Event(e.time - of_time.get(e.time, 0.0), e.name) for e in events]
        for name, indicator in times(moved).items():
            if indicator.value is not None:
                draws.setdefault(name, []).append(float(indicator.value))
    return {name: np.array(values) for name, values in draws.items()}


def _time_of_a_count(grounds: Grounds, edge: DecidingEdge) -> float:
    """How long the panel takes for one encoder count at an edge of the door, s."""
    if edge.signal is not Signal.DOOR or not grounds.joint.time.size:
        return 0.0
    row = int(np.searchsorted(grounds.joint.time, edge.time).clip(0, grounds.joint.time.size - 1))
    speed = abs(float(grounds.joint.velocity[row]))
    count = _encoder_count(grounds)
    return min(count / speed, _LONGEST_COUNT) if speed > 0 else 0.0


def _encoder_count(grounds: Grounds) -> float:
    """The smallest step of the door angle, rad; what the settings say where few are seen."""
    steps = np.abs(np.diff(grounds.door_angle))
    steps = steps[steps > _SAME_STEP]
    return float(steps.min()) if steps.size >= _FEWEST_STEPS else grounds.thresholds.encoder_count


def _looked_at(events: Sequence[Event]) -> Iterator[Event]:
    """The events that indicators look at: of a flickering door there are thousands."""
    last = {event.name: event for event in events}
    for name, event in last.items():
        if name is not EventName.DOOR_OPENS:
            yield event


# ---------------------------------------------------------------------------------- motion


def _motion(grounds: Grounds, random: np.random.RandomState) -> dict[Name, Array]:
    """The same motion, sampled at other instants by an encoder that stands elsewhere."""
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
    later = after - part.start + kernel.size // 2  # in a full convolution
    intervals = joint.time[after] - joint.time[after - 1]

    def quotients(noise: Array) -> Array:
        jerks: Array = np.convolve(noise, change_of_noise)[later] / intervals
        return jerks

    jerk = (smooth.acceleration[after] - smooth.acceleration[after - 1]) / intervals
    lost = (joint.acceleration[after] - joint.acceleration[after - 1]) / intervals - jerk
    tried = islice(_angle_errors(grounds, smooth, part, random), _TRIED)
    jerk += _share_of_motion(lost, [quotients(error) for error in tried]) * lost
    tops = _tops(low_passed[first : last + 1]) + first
    near = tops[:, None] - part.start + np.arange(response.size)[::-1] - response.size // 2
    near = near.clip(0, part.stop - part.start - 1)
    drawn = np.full((2, DRAWS), np.nan)
    for draw, error in enumerate(_angle_errors(grounds, smooth, part, random)):
        if after.size:
            mean = float(np.abs(jerk + quotients(error)).mean())
            drawn[0, draw] = SMOOTHNESS_SCALE / mean if mean else np.nan
        if tops.size:
            drawn[1, draw] = np.abs(low_passed[tops] + error[near] @ response).max()
    return {
        Name.SMOOTHNESS_OF_DOOR_ACTUATION: drawn[0],
        Name.UNSAFETY_OF_DOOR_OPERATION: drawn[1],
    }


def _share_of_motion(lost: Array, noises: Sequence[Array]) -> float:
    """How much of the jerk that smoothing took is motion, and not what encoder and stamps add.

    A robot that trembles is not to be taken for a smooth one.
    """
    power = float(np.square(lost).sum())
    noise = sum(float(np.square(each).sum()) for each in noises) / len(noises)
    return math.sqrt(max(0.0, 1 - noise / power)) if power else 0.0


def _jerks_in(grounds: Grounds, smooth: JointState, first: int, last: int) -> NDArray[np.intp]:
    """The later rows of the quotients that are jerk, in the run, of neighbours; shape (m,)."""
    before, after = jerk_rows(grounds.joint, grounds.ruleset, grounds.thresholds)
    kept = (after >= first) & (after <= last) & (before == after - 1)
    known = np.isfinite(smooth.acceleration)
    kept &= known[after] & known[before]
    return np.compress(kept, after)


def _angle_errors(
    grounds: Grounds, smooth: JointState, part: slice, random: np.random.RandomState
) -> Iterator[Array]:
    """What the encoder makes of a smooth motion, less the motion, rad, shape (rows,), each draw.

    Its steps are not noise: a slow panel stays on one for several samples. So each draw has the
    motion sampled a part of an interval later, by an encoder that stands a part of a count
    further on. What the stamps' jitter makes of it is noise, of uniform distribution.
    """
    count = _encoder_count(grounds)
    intervals = np.diff(grounds.door_time)
    regular = intervals[intervals <= grounds.thresholds.largest_gap]
    interval = float(regular.mean()) if regular.size else 0.0
    jitter = float(regular.std()) / math.sqrt(2) if regular.size else 0.0
    angle, speed = smooth.position[part], np.nan_to_num(grounds.joint.velocity[part])
    for phase, begins in random.random_sample((DRAWS, 2)):  # one by one: they stay in the cache
        moved = angle + interval * (phase - 0.5) * speed + count * begins
        error: Array = np.rint(moved / count) * count - moved
        if jitter > _LEAST_JITTER:
            noise = random.random_sample(error.size) - 0.5
            error += math.sqrt(12) * jitter * speed * noise
        yield error


def _tops(values: Array) -> NDArray[np.intp]:
    """Where the largest values stand."""
    size = np.nan_to_num(np.abs(values))
    known = np.flatnonzero(size > 0)
    if known.size > _MOST_TOPS:
        known = known[np.argpartition(size[known], -_MOST_TOPS)[-_MOST_TOPS:]]
    return known


# ---------------------------------------------------------------------------------- force


def _roughness(grounds: Grounds, random: np.random.RandomState) -> Array:
    """The force's noise, and samples that lie elsewhere about the peak."""
    force = grounds.rows.force - grounds.rows.rest
    if not force.size:
        return np.full(DRAWS, np.nan)
    size = np.abs(force)
    tops = _tops(np.where(size >= _NEAR_TOP * size.max(), size, 0.0))
    here = force[tops]
    left, right = force[(tops - 1).clip(0)], force[(tops + 1).clip(None, force.size - 1)]
    shift = random.random_sample((DRAWS, 1)) - 0.5
    curved = here + shift * (right - left) / 2 + shift**2 * (right - 2 * here + left) / 2
    noise = grounds.force_noise * random.standard_normal((DRAWS, tops.size))
    drawn: Array = np.abs(curved + noise).max(axis=1, initial=0.0)
    return drawn
