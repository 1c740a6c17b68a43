from __future__ import annotations

from dataclasses import replace

import pytest

from madrob_console.engine.shown.snapshot import EvidenceTopicView, EvidenceView, Snapshot
from madrob_console.ui.cells.lines import plain, width_of
from madrob_console.ui.panes.evidence_line import EvidenceLine
from tests.madrob_console.ui.fake_engine import FakeEngine

IMAGE = "sensor_msgs/msg/CompressedImage"


def camera(side: str, lost: int = 0, problem: str = "") -> EvidenceTopicView:
    return EvidenceTopicView(
        f"/camera/{side}/image/compressed", IMAGE, 29.8, 6_100_000.0, lost, problem
    )


def drawn(evidence: EvidenceView | None, width: int = 200) -> str:
    snapshot: Snapshot = replace(FakeEngine().snapshot(), evidence=evidence)
    rows = EvidenceLine().draw(snapshot, width)
    assert all(width_of(row) <= width for row in rows)
    return plain(rows).rstrip("\n")


def test_the_line_says_what_comes_how_long_it_fits_and_what_is_lost() -> None:
    evidence = EvidenceView((camera("left", 12), camera("right")), True, 48_000_000, 11 * 3600.0)
    before = replace(evidence, topics=(camera("left"),), recording=False)
    assert drawn(before) == "evidence  6.1 MB/s room for 11 h  camera/left 29.8 Hz 6.1 MB/s"
    assert drawn(evidence) == (
        "evidence  12.2 MB/s 48 MB 12 lost"
        "  camera/left 29.8 Hz 6.1 MB/s, 12 lost  camera/right 29.8 Hz 6.1 MB/s"
    )


@pytest.mark.parametrize("width", [40, 78, 80, 116])
def test_what_lacks_something_comes_first_and_the_rest_is_counted(width: int) -> None:
    sides = [camera(f"c{number}") for number in range(8)] + [camera("worst", 3)]
    text = drawn(EvidenceView(tuple(sides), True, 0, 60.0), width)
    assert text.startswith("evidence  54.9 MB/s")
    if width >= 78:
        assert "camera/worst 29.8 Hz 6.1 MB/s, 3 lost" in text
        assert text.endswith("more")


def test_without_a_wish_there_is_no_line_and_what_is_wrong_with_all_of_it_is_said() -> None:
    assert drawn(None) == ""
    assert drawn(EvidenceView()) == "evidence  none of its topics is there"
    problem = "the evidence process is started again: it was ended by SIGKILL"
    assert drawn(EvidenceView(problem=problem)) == f"evidence  {problem}"


def test_what_has_no_room_is_cut_with_a_sign() -> None:
    problem = "the evidence process is started again: it was ended by SIGKILL"
    assert drawn(EvidenceView(problem=problem), 40) == "evidence  the evidence process is start…"
    silent = camera("hall_3/above_the_door/left", problem="silent for 42 s")
    text = drawn(EvidenceView((silent, camera("right")), True, 0, 60.0), 78)
    assert text == (
        "evidence  12.2 MB/s  cam…or/left 29.8 Hz 6.1 MB/s, silent for 42 s  and 1 more"
    )
