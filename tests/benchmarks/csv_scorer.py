"""What an archive is compared with: the indicators of one run from ready-made csv files.

python -m tests.benchmarks.csv_scorer <folder>

A process for each run, as the published scripts are used: it reads with pandas what was
pre-processed before, filters with SciPy, and prints eight values.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.signal import butter, filtfilt, savgol_filter


def values(folder: Path) -> dict[str, float]:
    """The indicators of the one run in a folder."""
    (events_file,) = folder.glob("*_event.csv")
    (joint_file,) = folder.glob("*_jointState.csv")
    (wrench_file,) = folder.glob("*_wrench.csv")
    events, joint, wrench = map(pd.read_csv, (events_file, joint_file, wrench_file))
    start = events.time[0]

    def first(name: str) -> float:
        times = events.time[events.event == name]
        return float(times.iloc[0]) if len(times) else np.nan

    def last(name: str) -> float:
        times = events.time[events.event == name]
        return float(times.iloc[-1]) if len(times) else np.nan

    time, position = joint.time.to_numpy(), joint.position.to_numpy()
    acceleration = joint.acceleration.to_numpy()
    defined = np.isfinite(acceleration)
    rate = 1 / np.diff(time).mean()
    numerator, denominator = butter(5, 5.0, fs=rate)
    low_passed = filtfilt(numerator, denominator, acceleration[defined])
    jerk = savgol_filter(np.gradient(acceleration[defined], time[defined]), 11, 3)
    moving = np.abs(position[defined]) > 0.03
    names = set(events.event)
    steps = ("handle_is_touched", "door_opens", "humanoid_moves_to_cw_side", "door_closes")
    return {
        "time_to_handle": first("handle_is_touched") - start,
        "door_occupation_time": last("door_closes") - first("door_opens"),
        "passage_time": last("door_closes") - first("handle_is_touched"),
        "execution_time": last("door_closes") - start,
        "unsafety_of_door_operation": np.abs(low_passed).max(),
        "smoothness_of_door_actuation": np.abs(jerk[moving]).mean() if moving.any() else np.nan,
        "roughness_of_door_actuation": wrench.force_x.abs().max(),
        "capability_level": sum(name in names for name in steps),
    }


if __name__ == "__main__":
    for name, value in values(Path(sys.argv[1])).items():
        print(name, value)
