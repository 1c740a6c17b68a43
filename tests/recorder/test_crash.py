"""A killed process, a full disk: what was written stays, and nobody is left in the dark."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from recorder.message import RawMessage
from recorder.reader import read_bag

pytestmark = pytest.mark.machine
ROOT = Path(__file__).parents[2]


def victim(how: str, folder: Path, limit: int = 0) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "tests.recorder.victim", how, str(folder), str(limit)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        text=True,
    )


def report_of(process: subprocess.Popen[str]) -> dict[str, Any]:
    with process:
        output, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    report: dict[str, Any] = json.loads(output)
    return report


def numbers(messages: list[RawMessage]) -> list[int]:
    return [int.from_bytes(message.data[:4]) for message in messages]


@pytest.mark.parametrize("seconds", [0.7, 1.13])
def test_a_killed_recording_loses_less_than_half_a_second(tmp_path: Path, seconds: float) -> None:
    with victim("until-killed", tmp_path / "bag") as process:
        assert process.stdout is not None
        assert process.stdout.readline() == '"recording"\n'
        time.sleep(seconds)
        killed_ns = time.time_ns()
        process.send_signal(signal.SIGKILL)
    bag = read_bag(tmp_path / "bag")
    messages = list(bag.messages())
    assert numbers(messages) == list(range(len(messages)))
    assert killed_ns - messages[-1].receive_ns < 500_000_000
    assert not bag.complete
    assert bag.records == {"madrob_run": {"setup": "{}"}}
    assert [topic.definition for topic in bag.topics()] == ["uint8[] data\n"]
    assert (tmp_path / "bag" / "metadata.yaml").is_file()


def test_a_full_disk_is_reported_and_costs_only_what_it_did_not_take(tmp_path: Path) -> None:
    report = report_of(victim("on-a-small-disk", tmp_path / "bag", limit=2_000_000))
    assert report["state"] == "failed"
    assert "File too large; what was written stays readable" in report["error"]
    assert "\n" not in report["error"]
    assert report["accepted_after"] == [False, False, False]
    assert report["saved"] + report["dropped"] == report["handed_in"]
    assert report["queued"] == 0
    bag = read_bag(tmp_path / "bag")
    messages = list(bag.messages())
    assert numbers(messages) == list(range(len(messages)))
    assert len(messages) >= report["saved"] > 0
    assert not bag.complete
    assert bag.records == {"madrob_run": {"setup": "{}"}}


def test_a_disk_that_is_full_from_the_start_refuses_and_leaves_nothing(tmp_path: Path) -> None:
    report = report_of(victim("on-a-small-disk", tmp_path / "bag", limit=100))
    assert report["refused"].startswith(f"cannot record to {tmp_path / 'bag'}: File too large; ")
    assert not any(tmp_path.iterdir())


def test_a_folder_that_may_not_be_written_is_refused_with_the_remedy(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    report = report_of(victim("without-rights", tmp_path / "bag"))
    tmp_path.chmod(0o700)
    assert report["refused"] == (
        f"cannot record to {tmp_path / 'bag'}: Permission denied; "
        "choose a folder that exists and can be written, on a disk with room"
    )
