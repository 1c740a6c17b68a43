"""The least that scoring can do: load a run's published curves, filter them, write them.

python -m tests.benchmarks.bare_filter <folder of a run>
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np


def main(run: Path) -> None:
    """Door: Savitzky-Golay and a low-pass filter; force: a low-pass filter."""
    from scipy.signal import butter, filtfilt, savgol_filter

    (joint,), (wrench,) = run.glob("*_jointState.csv"), run.glob("*_wrench.csv")
    time, position, *_ = np.loadtxt(joint, delimiter=",", skiprows=1).T
    force = np.loadtxt(wrench, delimiter=",", skiprows=1).T[1]
    motion = [savgol_filter(position, 11, 3, deriv=order) for order in range(3)]
    jerk = filtfilt(*butter(2, 0.2), np.gradient(motion[-1]))
    np.savetxt(run / "bare.csv", np.column_stack([time, *motion, jerk]), delimiter=",")
    np.savetxt(run / "force.csv", filtfilt(*butter(2, 0.2), force), delimiter=",")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
