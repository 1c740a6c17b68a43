"""What the filters of the protocol do to a motion, from their definitions alone.

Nothing here uses the code that scores, nor SciPy's filters: kernels of the moving average and of
Savitzky-Golay in closed form, the Butterworth filter by its frequency response.
"""

from __future__ import annotations

import cmath
import math

import numpy as np
from numpy.typing import NDArray

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
