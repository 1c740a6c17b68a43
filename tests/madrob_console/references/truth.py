"""What each reference run must score to: what happened, and how far a right score may be off it.

Derived from the formulas of `runs.py` and from the definitions of the protocol's filters, never by
scoring: nothing here uses the code that scores, nor SciPy's filters. Kernels of the moving average
and of Savitzky-Golay come in closed form, the Butterworth filter by its frequency response.
"""

from __future__ import annotations

import cmath
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from madrob_console.cli.reference_set import Expected, Reference
from scoring.indicator_table import IndicatorName, RulesetName
from scoring.protocol import Outcome, Side, Step, Thresholds
from tests.madrob_console.references.runs import (
    CLOSED,
    COUNT,
    INTERVAL,
    SETTLE,
    ReferenceRun,
    Swing,
    Tremor,
)

Array = NDArray[np.float64]

_ROOM = 4
"""A series is filtered in so many times its length, so that its end does not reach its begin."""


def acceleration_kernel(average: int, savgol: int, interval: float) -> Array:
    """What both windows of odd lengths come to, 1/s^2: angles times this are an acceleration.

    The least squares parabola through 2m + 1 samples has the second derivative
    sum((j^2 - S2/S0) * x_j) * 2 / (S4 - S2^2/S0), with S_n = sum(j^n) over j = -m..m.
    """
    j = np.arange(savgol, dtype=np.float64) - savgol // 2
    s0, s2, s4 = savgol, float((j**2).sum()), float((j**4).sum())
    parabola = 2 * (j**2 - s2 / s0) / (s4 - s2**2 / s0)
    return np.convolve(np.full(average, 1 / average), parabola) / interval**2


def kernel_gain(average: int, savgol: int, interval: float, frequency: float) -> float:
    """Acceleration behind both windows over the true one, of a sine at `frequency`, Hz."""
    kernel = acceleration_kernel(average, savgol, interval)
    j = np.arange(kernel.size) - kernel.size // 2
    omega = math.tau * frequency
    return float(-(kernel * np.cos(omega * j * interval)).sum() / omega**2)


def butterworth(frequency: float, order: int, critical: float, interval: float) -> complex:
    """Response of the digital filter at `frequency`, Hz: the analog poles, bilinear transform."""
    warped = math.tan(math.pi * frequency * interval) / math.tan(math.pi * critical * interval)
    response = 1 + 0j
    for k in range(order):
        pole = cmath.exp(1j * math.pi * (2 * k + order + 1) / (2 * order))
        response *= -pole / (1j * warped - pole)
    return response


def responses(size: int, order: int, critical: float, interval: float) -> NDArray[np.complex128]:
    """The responses at the frequencies of `np.fft.rfft` of `size` samples."""
    frequencies = np.fft.rfftfreq(size, interval)
    inner = [butterworth(f, order, critical, interval) for f in frequencies[:-1]]
    return np.array([*inner, 0.0])  # nothing passes at half the sampling rate


def low_passed(series: Array, interval: float, *, both_ways: bool) -> Array:
    """A series, 0 before and after, behind the low-pass filter of order 5 at 2 Hz."""
    size = _ROOM * series.size
    response = responses(size, 5, 2.0, interval)
    if both_ways:
        response = (np.abs(response) ** 2).astype(np.complex128)
    return np.fft.irfft(np.fft.rfft(series, size) * response, size)[: series.size]


def noise_gain(kernel: Array, interval: float, *, both_ways: bool) -> float:
    """Standard deviation behind kernel and low-pass filter of noise of 1 that is all colours."""
    size = 4096
    response = np.abs(responses(size, 5, 2.0, interval)) ** (2 if both_ways else 1)
    spectrum = np.abs(np.fft.rfft(kernel, size)) * response
    both_halves = np.concatenate([spectrum, spectrum[1:-1]])
    return float(np.sqrt((both_halves**2).mean()))


TICK = 1e-6
"""s: what the digits of a time in s since the epoch may do to it."""

TOUCH = Thresholds().touch_force


@dataclass(frozen=True, slots=True)
class Rules:
    """What a ruleset asks of these runs (protocol sections 4 to 9)."""

    name: RulesetName
    average: int
    savgol: int
    both_ways: bool
    present: float
    to_end: bool

    @property
    def kernel(self) -> Array:
        """Of the two windows."""
        return acceleration_kernel(self.average, self.savgol, INTERVAL)


PROTOCOL = Rules(RulesetName.PROTOCOL, 9, 9, both_ways=True, present=0.5, to_end=False)
EUROBENCH = Rules(RulesetName.EUROBENCH_2020, 11, 11, both_ways=False, present=1.0, to_end=True)


@dataclass(frozen=True, slots=True)
class Span:
    """When something happened, and when a right score may say that it did, s since the start."""

    truth: float
    lowest: float
    highest: float
    why: str

    def since(self, earlier: Span) -> Span:
        """The time from another instant to this one."""
        return Span(
            self.truth - earlier.truth,
            self.lowest - earlier.highest,
            self.highest - earlier.lowest,
            f"{self.why}; since {earlier.why}",
        )

    def expected(self) -> Expected:
        """As the reference has it."""
        return Expected(
            truth=self.truth, lowest=self.lowest - TICK, highest=self.highest + TICK, why=self.why
        )


START = Span(0.0, 0.0, 0.0, "the start")


def seen(truth: float, what: str) -> Span:
    """An instant that is seen at the first sample after it, at most one interval late."""
    why = f"{what} at {truth:.4f} s, seen up to {INTERVAL:g} s later"
    return Span(truth, truth, truth + INTERVAL, why)


@dataclass(frozen=True, slots=True)
class Facts:
    """What happens in a run, as far as a ruleset wants to know; None = it does not."""

    touched: Span | None
    opened: Span | None
    closed: Span | None
    approached: Span | None
    left: Span | None
    stop: Span


def facts(run: ReferenceRun, rules: Rules) -> Facts:
    """What happens in a run."""
    opened, closed = _door(run)
    if run.timeout is None:
        assert closed is not None
        stop = closed
    else:
        stop = Span(run.timeout, run.timeout, run.timeout, f"the timeout at {run.timeout:g} s")
    return Facts(
        _touch(run), opened, closed, _approach(run, rules), _leaving(run, rules, stop), stop
    )


def _touch(run: ReferenceRun) -> Span | None:
    if not run.pulses:
        return None
    pulse = run.pulses[0]
    rise = math.asin(TOUCH / abs(pulse.peak)) * pulse.duration / math.pi
    return seen(pulse.begins + rise, f"the force passes {TOUCH:.2f} N")


def _door(run: ReferenceRun) -> tuple[Span | None, Span | None]:
    """When the door opens, and when it is closed again."""
    times = [t for t in run.times() if abs(run.angle(t)) >= CLOSED]
    if not times:
        return None, None
    half = COUNT / 2 if run.encoder else 0.0

    def passed(near: float, what: str) -> Span:
        early, truth, late = sorted(
            _passes(run, CLOSED + step, near) for step in (-half, 0.0, half)
        )
        rounding = ", half a count earlier or later" if half else ""
        why = f"{what} at {truth:.4f} s, seen up to {INTERVAL:g} s later{rounding}"
        return Span(truth, early, late + INTERVAL, why)

    opened = passed(times[0], "the door opens")
    last = times[-1]
    still_open = last == run.times()[-1]
    return opened, None if still_open else passed(last, "the door closes")


def _passes(run: ReferenceRun, angle: float, near: float) -> float:
    """When the panel passes an angle, near a time."""
    low, high = near - 2 * INTERVAL, near + 2 * INTERVAL
    rising = abs(run.angle(high)) > abs(run.angle(low))
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if (abs(run.angle(middle)) < angle) is rising else (low, middle)
    return low


def _approach(run: ReferenceRun, rules: Rules) -> Span | None:
    rises = [stay.since for stay in run.stays if stay.height > rules.present]
    words = f"more than {rules.present:g} m are under a sensor"
    return seen(min(rises), words) if rises else None


def _leaving(run: ReferenceRun, rules: Rules, stop: Span) -> Span | None:
    """When the robot leaves on its destination side; every run that leaves does so there."""
    falls = [stay.until for stay in run.stays if stay.height > rules.present]
    if not falls:
        return None
    assert max(falls) == max(s.until for s in run.stays if s.side is run.condition.destination_side)
    if run.panel_seen:
        return _masked_leaving(run, rules)
    if rules.to_end or max(falls) < stop.truth:
        return seen(max(falls), "the last sensor is free")
    return Span(stop.truth, stop.lowest, stop.highest, f"under a sensor until the stop: {stop.why}")


def _masked_leaving(run: ReferenceRun, rules: Rules) -> Span:
    """The robot leaves while all sensors are masked, and the panel closes above them.

    A masked sensor keeps its state until its mask ends, the last one at the smallest angle; or it
    counts as absent, the last one from where its mask begins.
    """
    thresholds = Thresholds()
    cw = run.condition.destination_side is Side.CW
    upper = thresholds.mask_to_cw if cw else thresholds.mask_to_ccw
    angle = min(upper) if rules.to_end else min(thresholds.mask_from)
    near = max(time for time in run.times() if abs(run.angle(time)) >= angle)
    what = "begins" if rules.to_end else "ends"
    words = f"the mask of the last sensor {what} with the panel at {angle:g} rad"
    return seen(_passes(run, angle, near), words)


NUMBERS = 1e-5
"""Relative: what arithmetic and the ends of a recording may do to an exact door."""

_NOTHING = 1e-9
_ARITHMETIC = f", and {NUMBERS:.3%} for arithmetic"

DEVIATIONS = 4.0
"""So many standard deviations the encoder's rounding may be off."""

_ROUNDING = COUNT / math.sqrt(12)
"""Standard deviation of the encoder's rounding, rad."""


class Motion:
    """What the door's motion comes to."""

    def __init__(self, run: ReferenceRun, rules: Rules) -> None:
        self._run, self._rules = run, rules
        times = np.array(run.times())
        angles = np.array([round(run.angle(t), 12) for t in run.times()])
        edge = rules.kernel.size // 2
        acceleration = np.convolve(angles, rules.kernel, mode="valid")
        whole = slice(edge, times.size - edge)
        self._low_passed = low_passed(acceleration, INTERVAL, both_ways=rules.both_ways)
        self._times, self._angles = times[whole], angles[whole]
        self._acceleration = acceleration
        end = run.stop + (SETTLE if run.timeout is None else 0.0)
        self._inside = (self._times >= 0) & (self._times <= end) | rules.to_end

    def unsafety(self) -> Expected:
        """The largest low-passed acceleration."""
        largest = float(np.abs(self._low_passed[self._inside]).max())
        run, rules = self._run, self._rules
        margin = largest * NUMBERS + _NOTHING
        truth, words = self._true_acceleration()
        why = f"{words}; behind the filters {largest:.6g}"
        if not run.encoder:
            why += _ARITHMETIC
        else:
            noise = noise_gain(rules.kernel, INTERVAL, both_ways=rules.both_ways) * _ROUNDING
            margin = DEVIATIONS * noise
            why += f"; the encoder's rounding has a standard deviation of {noise:.2g} behind them"
        return Expected(
            truth=truth, lowest=max(0.0, largest - margin), highest=largest + margin, why=why
        )

    def _true_acceleration(self) -> tuple[float | None, str]:
        rules = self._rules
        match self._run.angle:
            case Swing(smooth=True) as swing:
                within = [swing.opening, swing.closing]
                if swing.closes > self._run.length:
                    within.pop()
                largest = 10 / math.sqrt(3) * abs(swing.top) / min(within) ** 2
                return largest, "10/sqrt(3) * angle / time^2 of the faster motion"
            case Tremor() as tremor:
                largest = tremor.amplitude * (math.tau * tremor.frequency) ** 2
                windows = kernel_gain(rules.average, rules.savgol, INTERVAL, tremor.frequency)
                pass_ = abs(butterworth(tremor.frequency, 5, 2.0, INTERVAL))
                low = pass_**2 if rules.both_ways else pass_
                ways = "forth and back" if rules.both_ways else "one way"
                return largest, (
                    f"A w^2 = {largest:.5g}; times {windows:.5f} (moving average, Savitzky-Golay) "
                    f"times {low:.5f} (Butterworth, {ways}) = {largest * windows * low:.5g} at "
                    f"{tremor.frequency:g} Hz"
                )
            case _ if not self._angles.any():
                return 0.0, "the door does not move"
            case _:
                return None, "a step of the speed, whose acceleration only the filters limit"

    def smoothness(self) -> Expected:
        """10 over the mean absolute jerk of the open door."""
        jerk, speed = self._jerk()
        if not jerk.size:
            return Expected(missing="door never opened", why="a closed door has no jerk")
        clean = float(np.abs(jerk).mean())
        truth, words = self._true_smoothness()
        why = f"{words}; behind the filters {10 / clean:.6g}"
        if not self._run.encoder:
            value, part = 10 / clean, NUMBERS
            why += _ARITHMETIC
            return Expected(
                truth=truth, lowest=value * (1 - part), highest=value * (1 + part), why=why
            )
        steps = np.diff(self._rules.kernel, prepend=0.0, append=0.0) / INTERVAL
        noise = float(np.sqrt((steps**2).sum())) * _ROUNDING
        noisy = _folded(jerk, noise)
        fast = np.abs(speed) * INTERVAL >= COUNT
        most = float(noisy.mean())
        least = float(np.where(fast, noisy, np.abs(jerk)).mean())
        spread = DEVIATIONS * noise * math.sqrt((1 - 2 / math.pi) * steps.size / jerk.size)
        why += (
            f"; the encoder's rounding has a standard deviation of {noise:.3g} rad/s^3 behind "
            "them, at full strength where the door turns by more than a count between samples"
        )
        return Expected(
            truth=truth,
            lowest=10 / (most + spread),
            highest=10 / max(clean, least - spread),
            why=why,
        )

    def _jerk(self) -> tuple[Array, Array]:
        """Jerk and speed of the exact door in the rows that count."""
        is_open = np.abs(self._angles) > CLOSED
        speed = np.gradient(self._angles, INTERVAL)
        if self._rules.to_end:
            rows = np.flatnonzero(is_open)
            gone = np.diff(self._times[rows])
            return np.diff(self._acceleration[rows]) / gone, speed[rows][1:]
        counts = (is_open & self._inside)[1:]
        return (np.diff(self._acceleration) / INTERVAL)[counts], speed[1:][counts]

    def _true_smoothness(self) -> tuple[float | None, str]:
        """From what the acceleration goes up and down by while the door is open."""
        swing = self._run.angle
        found = facts(self._run, self._rules)
        opened, closed = found.opened, found.closed
        if not isinstance(swing, Swing) or not swing.smooth or opened is None or closed is None:
            return None, "what the acceleration goes up and down by, over the time open"
        peaks = [
            10 / math.sqrt(3) * abs(swing.top) / duration**2
            for duration in (swing.opening, swing.closing)
        ]
        before = [
            abs(swing.top) / duration**2 * (60 * x - 180 * x**2 + 120 * x**3)
            for duration, x in (
                (swing.opening, (opened.truth - swing.opens) / swing.opening),
                (swing.closing, (swing.closes + swing.closing - closed.truth) / swing.closing),
            )
        ]
        ways = 4 * sum(peaks) - sum(before)
        open_for = closed.truth - opened.truth
        words = f"the acceleration goes up and down by {ways:.5g} in {open_for:.4f} s"
        return 10 * open_for / ways, words


def _folded(mean: Array, deviation: float) -> Array:
    """Mean of the absolute value of normal numbers about each mean."""
    ratio = np.abs(mean) / deviation
    inside = np.array([math.erf(r / math.sqrt(2)) for r in ratio])
    outside: Array = deviation * math.sqrt(2 / math.pi) * np.exp(-(ratio**2) / 2)
    folded: Array = outside + np.abs(mean) * inside
    return folded


def reference(run: ReferenceRun) -> Reference:
    """All that a run must score to."""
    return Reference(
        recording=f"{run.name}.mcap",
        about=run.about,
        outcome=Outcome.COMPLETED if run.timeout is None else Outcome.TIMEOUT,
        steps=_steps(facts(run, PROTOCOL)),
        indicators={rules.name: _indicators(run, rules) for rules in (PROTOCOL, EUROBENCH)},
    )


def _steps(found: Facts) -> dict[str, Expected]:
    """The times of the steps, which are the protocol's in every ruleset."""
    instants = [found.touched, found.opened, found.opened, found.left, found.closed, found.closed]
    expected: dict[str, Expected] = {}
    done: list[Span] = []
    for step, instant in zip(Step, instants, strict=True):
        if instant is None:
            break
        latest = max([*done, instant], key=lambda span: span.truth)
        done.append(latest)
        expected[str(step.value)] = latest.expected()
    for step in Step:
        if step > len(done):
            first = step == len(done) + 1
            words = _UNDONE[step] if first else f"comes after step {step - 1}"
            why = "a step counts only after all steps before it"
            expected[str(step.value)] = Expected(missing=words, why=why)
    return expected


_UNDONE = {
    Step.TOUCH: "handle not touched",
    Step.UNLOCK: "implied by opening",
    Step.CLOSE: "door not closed",
}
"""Why the first step is not done that is not, of those that can be the first here."""


def _indicators(run: ReferenceRun, rules: Rules) -> dict[IndicatorName, Expected]:
    found, motion = facts(run, rules), Motion(run, rules)
    start, touched = (START, "no benchmark start"), (found.touched, "handle never touched")
    approached = found.approached, "robot never approached on the starting side"
    left = found.left, "robot never reached the destination side"
    opened, closed = (found.opened, "door never opened"), (found.closed, "door never closed")
    ends = max(left, closed, key=lambda end: end[0].truth if end[0] else 0.0)
    return {
        IndicatorName.EXECUTION_TIME: _between(start, left, closed, ends)
        if rules.to_end
        else found.stop.since(START).expected(),
        IndicatorName.TIME_TO_HANDLE: _between(start, touched),
        IndicatorName.DOOR_OCCUPATION_TIME: _between(approached, left),
        IndicatorName.PASSAGE_TIME: _between(touched, closed)
        if rules.to_end
        else _between(touched, opened, closed),
        IndicatorName.UNSAFETY_OF_DOOR_OPERATION: motion.unsafety(),
        IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION: motion.smoothness(),
        IndicatorName.ROUGHNESS_OF_DOOR_ACTUATION: _roughness(run),
        IndicatorName.CAPABILITY_LEVEL: _capability(found, rules),
    }


def _between(*instants: tuple[Span | None, str]) -> Expected:
    """From the first to the last; what did not happen of them is named in their order."""
    happened = [span for span, _ in instants if span is not None]
    if len(happened) < len(instants):
        missing = next(words for span, words in instants if span is None)
        return Expected(missing=missing, why="what did not happen has no time")
    return happened[-1].since(happened[0]).expected()


def _capability(found: Facts, rules: Rules) -> Expected:
    if rules.to_end:
        happened = (found.approached, found.touched, found.left, found.closed)
        level = sum(each is not None for each in happened)
        why = "of approach, touch, leaving and closing so many happen"
    else:
        level = sum(one.missing is None for one in _steps(found).values())
        why = "so many steps are done in their order"
    return Expected(truth=level, lowest=level, highest=level, why=why)


def _roughness(run: ReferenceRun) -> Expected:
    if not run.pulses:
        return Expected(truth=0.0, lowest=0.0, highest=0.0, why="no force at any time")
    peaks = [abs(run.handle_zero + pulse.peak) for pulse in run.pulses]
    strongest = run.pulses[peaks.index(max(peaks))]
    loss = 1 - math.cos(math.pi * INTERVAL / 2 / strongest.duration)
    why = (
        f"half a sine of {strongest.peak:g} N on {run.handle_zero:g} N at rest, of which no zero "
        f"is subtracted; its peak lies at most {INTERVAL / 2:g} s beside a sample"
    )
    return Expected(
        truth=max(peaks),
        lowest=max(peaks) - loss * abs(strongest.peak),
        highest=max(peaks),
        why=why,
    )


def expected_text(references: Sequence[Reference]) -> bytes:
    """The file that is shipped with the recordings; what is null is left out."""

    def told(part: dict[str, object]) -> dict[str, object]:
        return {key: value for key, value in part.items() if value is not None}

    content = json.loads(msgspec.json.encode(references), object_hook=told)
    return msgspec.json.format(msgspec.json.encode(content), indent=1) + b"\n"
