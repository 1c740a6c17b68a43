"""Cameras that come late, fall silent and come again, as a run's journal and result tell it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from madrob_console.engine.live.evidence_notes import EvidenceNotes
from madrob_console.engine.live.witness import WitnessStatus
from madrob_console.referee.evidence_account import EvidenceGap
from tests.madrob_console.engine.drive import make_setup
from tests.madrob_console.engine.test_evidence import LEFT, Watched

START = 1000.0


def silent(begin: float, end: float | None = None) -> EvidenceGap:
    """From when to when, s since the start."""
    return EvidenceGap(START + begin, None if end is None else START + end, "nothing came")


class Journal:
    """What it says of silences, one status after the other."""

    def __init__(self) -> None:
        self._notes = EvidenceNotes()

    def says(self, **pauses: list[EvidenceGap]) -> list[str]:
        told = {f"/{topic}": tuple(each) for topic, each in pauses.items()}
        return self._notes.due(WitnessStatus(recording=True, pauses=told), START, START + 99.0)

    def hears_first(self, **first: float) -> list[str]:
        told = {f"/{topic}": START + at for topic, at in first.items()}
        return self._notes.due(WitnessStatus(recording=True, appeared=told), START, START + 99.0)


def test_a_camera_s_silence_is_noted_when_it_begins_and_when_it_comes_again() -> None:
    journal = Journal()
    first, second = silent(3.9), silent(20.0)
    over = silent(3.9, 8.5)
    assert journal.says() == []
    assert journal.says(left=[first]) == ["/left: silent since +3.9 s"]
    assert journal.says(left=[first]) == []
    assert journal.says(left=[over]) == ["/left: comes again, silent from +3.9 s to +8.5 s"]
    assert journal.says(left=[over]) == []
    assert journal.says(left=[over, second]) == ["/left: silent since +20.0 s"]
    again = silent(20.0, 25.0)
    assert journal.says(left=[over, again]) == [
        "/left: comes again, silent from +20.0 s to +25.0 s"
    ]


def test_cameras_of_one_cable_share_a_line() -> None:
    journal = Journal()
    hub = {f"c{number}": [silent(3.9 + number / 100)] for number in range(6)}
    assert journal.says(**hub) == ["/c0, /c1 and 4 more: silent since +3.9 s"]
    back = {name: [silent(3.9, 8.5)] for name in hub}
    assert journal.says(**back) == [
        "/c0, /c1 and 4 more: comes again, silent from +3.9 s to +8.5 s"
    ]


def test_the_first_message_of_a_topic_that_appears_after_the_start_is_noted_once() -> None:
    journal = Journal()
    assert journal.hears_first(early=-1.5) == []
    assert journal.hears_first(early=-1.5, late=14.2) == ["/late: first message at +14.2 s"]
    assert journal.hears_first(early=-1.5, late=14.2) == []


def test_a_camera_s_times_stand_in_journal_and_result_from_the_start_on(tmp_path: Path) -> None:
    drive = Watched(tmp_path / "runs")
    drive.start(make_setup())
    start = drive.engine.run.start
    assert start is not None
    drive.wait(2.0)
    gone = EvidenceGap(start + 1.9, None, "nothing came")
    drive.witness.status = replace(drive.witness.status, pauses={LEFT: (gone,)})
    drive.wait(1.0)
    back = replace(gone, end=start + 6.5)
    drive.witness.status = replace(
        drive.witness.status, pauses={LEFT: (back,)}, appeared={"/camera/late": start + 4.2}
    )
    drive.wait(1.0)
    drive.finish()
    texts = [line.text for line in drive.engine.log.lines]
    for told in (
        f"{LEFT}: silent since +1.9 s",
        f"{LEFT}: comes again, silent from +1.9 s to +6.5 s",
        "/camera/late: first message at +4.2 s",
    ):
        assert texts.count(f"evidence: {told}") == 1
    (topic,) = json.loads((drive.folder / "result.json").read_text())["evidence"]["topics"]
    assert topic["problem"] == "silent from +1.9 s to +6.5 s"
