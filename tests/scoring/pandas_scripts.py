"""The eight indicators as EUROBENCH's published scripts compute them, in pandas' words.

Written from section 9 of the protocol alone; it shares no line with what it judges. Numbers are
read by Python: pandas' own parser errs by one unit in the last place (section 11).
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from scipy import signal


def values(event: Path, wrench: Path, joint: Path, condition: Path) -> dict[str, float | int | str]:
    """What stands in the YAML file of each indicator."""
    set_up = yaml.safe_load(condition.read_text())
    start_side = set_up["robot_approach_side"].lower()
    goal_side = {"cw": "ccw", "ccw": "cw"}[start_side]
    events, motion, forces = _table(event), _table(joint), _table(wrench)
    first, last = events.groupby("event").time.min(), events.groupby("event").time.max()
    start = first["benchmark_start"]
    touch = first.get("handle_is_touched", np.nan)
    approach = first.get(f"humanoid_approaches_the_door_on_{start_side}_side", np.nan)
    through = last.get(f"humanoid_moves_to_{goal_side}_side", np.nan)
    closed = last.get("door_closes", np.nan)
    occupied = through - approach
    open_rows = motion[motion.position.abs() > 0.03]
    jerk = open_rows.acceleration.diff() / open_rows.time.diff()
    numbers = {
        "execution_time": np.maximum(closed, through) - start,
        "time_to_handle": touch - start,
        "door_occupation_time": occupied if occupied > 0 else np.nan,
        "passage_time": closed - touch,
        "unsafety_of_door_operation": _unsafety(motion.dropna(subset=["acceleration"])),
        "smoothness_of_door_actuation": 10 / jerk.abs().mean(),
        "roughness_of_door_actuation": forces.force_x.abs().max(),
    }
    told = {name: "TIMEOUT" if np.isnan(x) else float(x) for name, x in numbers.items()}
    reached = ~np.isnan([approach, touch, through, closed])
    return told | {"capability_level": int(reached.sum())}


def _unsafety(rows: pd.DataFrame) -> float:
    rate = 1 / np.diff(rows.time).mean()
    numerator, denominator = signal.butter(5, 2.0, fs=rate)
    return float(np.abs(signal.lfilter(numerator, denominator, rows.acceleration)).max())


def _table(path: Path) -> pd.DataFrame:
    with path.open(newline="") as file:
        head, *rows = csv.reader(file)
    frame = pd.DataFrame(rows, columns=head)
    for column in head:
        if column != "event":
            frame[column] = [float(cell) if cell else np.nan for cell in frame[column]]
    return frame
