"""The short text in an export that says how to open each file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from madrob_console.archive.folders import PICTURES_FOLDER, PICTURES_INDEX
from madrob_console.archive.result_document import SCHEMA_FILE
from madrob_console.export.foxglove_layout import LAYOUT_FILE
from madrob_console.export.zip_file import SUMS_FILE
from recorder.bag import is_evidence

README_FILE = "README.txt"
"""How the text is called in the export."""


@dataclass(frozen=True, slots=True)
class PackedRun:
    """A run in an export.

    Attributes:
        folder: its name.
        words: how it ended, for people.
        files: the names of its files in the archive.
    """

    folder: str
    words: str
    files: Sequence[str]

    @property
    def table(self) -> str:
        """Its file of the panel's motion, named like the folder without date and time."""
        return self.folder[: -len("_YYYYMMDD_HHMMSS")] + "_jointState.csv"

    def has(self, name: str) -> bool:
        """Whether a file of its folder is there."""
        return f"{self.folder}/{name}" in self.files


def readme(
    title: str,
    runs: Sequence[PackedRun],
    problems: Sequence[str],
    renamed: Sequence[str] = (),
    other_names: Sequence[str] = (),
    *,
    bags: bool,
    evidence_left_out: bool = False,
) -> str:
    """The text.

    Args:
        title: whose runs.
        runs: in their order.
        problems: what is missing, in words.
        renamed: what is called otherwise here than in the run's folder, in words.
        other_names: of the team, in some of the runs.
        bags: whether the recordings are there.
        evidence_left_out: whether there is evidence of the runs that is not.
    """
    texts = [title, _runs(runs)]
    if other_names:
        texts.append("OTHER NAMES OF THE TEAM, IN SOME OF ITS RUNS\n" + _lines(other_names))
    if problems:
        texts.append("NOT IN THIS ARCHIVE\n" + _lines(problems))
    if renamed:
        texts.append("UNDER ANOTHER NAME\n" + _lines(renamed))
    texts.append(_WHOLE.format(sums=SUMS_FILE))
    if any(run.has("report.html") for run in runs):
        pictured = any(run.has(f"{PICTURES_FOLDER}/{PICTURES_INDEX}") for run in runs)
        texts.append(_REPORT + (_PICTURES if pictured else ""))
    if computed := [run for run in runs if run.has(run.table)]:
        texts.append(_PANDAS.format(table=f"{computed[0].folder}/{computed[0].table}"))
    texts.append(_RESULT.format(schema=SCHEMA_FILE))
    if recorded := [run.folder for run in runs if run.has(f"{run.folder}_0.mcap")]:
        texts.append(_BAG.format(bag=recorded[0], layout=LAYOUT_FILE))
    elif not bags:
        texts.append("RECORDINGS\nThey were left out of this archive; ask the referee for them.")
    if evidence_left_out:
        texts.append(_NO_EVIDENCE)
    elif evidence := [name for run in runs for name in run.files if is_evidence(name)]:
        texts.append(_EVIDENCE.format(file=evidence[0]))
    return "\n\n".join(texts) + "\n"


def _runs(runs: Sequence[PackedRun]) -> str:
    return "RUNS\n" + _lines(f"{run.folder}: {run.words}" for run in runs)


def _lines(texts: Iterable[str]) -> str:
    return "\n".join(f"  {text}" for text in texts)


_WHOLE = """\
IS EVERYTHING WHOLE?
  sha256sum -c {sums}
(on a Mac: shasum -a 256 -c {sums})"""

_REPORT = """\
THE REPORT
Open report.html of a run in any browser, also on a phone; it prints well."""

_PICTURES = f"""
The folder {PICTURES_FOLDER} has what the cameras saw at each event, larger than the page."""

_PANDAS = """\
THE DATA, IN PYTHON

import pandas as pd
motion = pd.read_csv("{table}")
print(motion.describe())

..._jointState.csv: time (s since 1970), position (rad), velocity (rad/s), acceleration (rad/s^2)
..._wrench.csv: time (s), force_x (N, on the handle)
..._event.csv: time (s), event
One .yaml for each indicator (none in an aborted run), condition_N.yaml and run_info_....yaml
say the rest in EUROBENCH's words."""

_RESULT = """\
THE WHOLE RESULT
result.json: values with their units or the reason why there is none, times of the steps as the
sensors and the referee have them, data quality, the referee's decisions. {schema}
describes every key. journal.jsonl: everything that was done, a line each."""

_BAG = """\
THE RECORDING
Each run folder is a rosbag2 bag (MCAP). With ROS 2 and ros-jazzy-rosbag2-storage-mcap:
  ros2 bag info {bag}
  ros2 bag play {bag}
With Foxglove (foxglove.dev): open the .mcap file of the run, then import the layout
{layout}."""

_EVIDENCE = """\
THE EVIDENCE
Files called ..._evidence_N.mcap hold cameras and other topics, as {file}.
Nothing is scored from them. They belong to the bag: ros2 bag and Foxglove open them like the
recording, and metadata.yaml lists them."""

_NO_EVIDENCE = """\
EVIDENCE
Cameras and other topics of some runs were left out of this archive; ask the referee for them."""
