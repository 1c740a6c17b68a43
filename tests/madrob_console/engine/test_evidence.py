"""What is recorded beside a run, as its engine has it."""

from __future__ import annotations

import json
import threading
from pathlib import Path
from typing import Any

import msgspec
import pytest

from madrob_console.engine.runtime.evidence_process import EvidenceProcess
from madrob_console.engine.runtime.testbed_engine import Engine
from madrob_console.messages.types import MessageTypes
from madrob_console.referee.evidence import Evidence, EvidenceTopic
from madrob_console.referee.journal import read_journal
from madrob_console.referee.rebuild import rebuild
from tests.madrob_console.engine.drive import Drive, document, make_setup

KILLED = "the recorder of the evidence is started again: it was ended by SIGKILL"
RECORDED = Evidence({"/camera": EvidenceTopic(600, 3)})


class FakeProcess(EvidenceProcess):
    """Says what a test tells it to; no process runs."""

    told = Evidence()

    def __init__(self) -> None:
        super().__init__(0, ["/camera"], 0)
        self.folders: list[Path] = []
        self.is_told = False
        self.hangs = threading.Event()

    @property
    def evidence(self) -> Evidence:
        return self.told

    def begin_recording(self, folder: Path, steady_ns: int) -> None:
        self.folders.append(folder)

    def end_recording(self) -> None:
        self.is_told = True

    def wait_until_ended(self, limit: float) -> None:
        assert self.is_told
        self.hangs.wait(limit)


class Filmed(Drive):
    """A run beside which a camera is recorded."""

    def __init__(self, results: Path) -> None:
        super().__init__(results)
        self.process = FakeProcess()
        config, types = self.engine.config, MessageTypes()
        self.engine = Engine(self.source, self.clock, config, types, evidence=self.process)
        self.engine.open()

    def lines(self) -> list[str]:
        """What the journal says of the evidence."""
        entries, _ = read_journal(self.folder / "journal.jsonl")
        return [entry.reason for entry in entries if entry.what.startswith("evidence")]


@pytest.fixture
def drive(tmp_path: Path) -> Filmed:
    return Filmed(tmp_path / "runs")


def test_account_is_in_journal_and_result_and_doubts_nothing(drive: Filmed) -> None:
    drive.start(make_setup(timeout=5.0))
    drive.process.told = RECORDED
    drive.process.hangs.set()

    drive.finish()

    result: dict[str, Any] = document(drive.folder)
    entries, _ = read_journal(drive.folder / "journal.jsonl")
    assert drive.process.folders == [drive.folder]
    assert rebuild(entries).evidence == RECORDED
    assert result["evidence"] == json.loads(msgspec.json.encode(RECORDED))
    assert drive.lines() == ["1 topic, 600 messages, 3 lost"]
    assert result["quality"]["remarks"] == []
    assert not any(indicator["doubts"] for indicator in result["indicators"].values())


def test_each_death_is_a_line_and_a_fault_below_all_others(drive: Filmed) -> None:
    drive.process.hangs.set()
    drive.start(make_setup(timeout=5.0))
    for problem in (KILLED, KILLED, "", KILLED):
        drive.process.told = Evidence(problem=problem)
        drive.wait(0.5)
    assert drive.engine.snapshot(None, ["the report fails"]).all_faults == (
        "the report fails",
        f"evidence: {KILLED}",
    )

    drive.finish()

    assert drive.lines() == [KILLED, KILLED, "0 topics, 0 messages"]
    assert not any("evidence" in fault for fault in drive.engine.snapshot().faults)


def test_process_that_hangs_does_not_hold_the_result(drive: Filmed) -> None:
    drive.start(make_setup(timeout=5.0))

    drive.finish()

    assert document(drive.folder)["evidence"] == {"topics": {}, "problem": ""}
