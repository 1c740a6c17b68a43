"""What the door of a reference run comes to: acceleration and jerk behind the filters."""

from __future__ import annotations

import math

import numpy as np

from madrob_console.cli.reference_set import Expected
from tests.madrob_console.references.facts import Rules, facts
from tests.madrob_console.references.filters import (
    Array,
    butterworth,
    kernel_gain,
    low_passed,
    noise_gain,
)
from tests.madrob_console.references.runs import (
    CLOSED,
    COUNT,
    INTERVAL,
    SETTLE,
    ReferenceRun,
    Swing,
    Tremor,
)

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
            case Swing() as swing:
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
        if not isinstance(swing, Swing) or opened is None or closed is None:
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
