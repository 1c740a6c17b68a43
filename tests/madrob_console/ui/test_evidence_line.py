from __future__ import annotations

from dataclasses import replace

import pytest

from madrob_console.engine.shown.snapshot import EvidenceTopicView, EvidenceView, Snapshot
from madrob_console.referee.evidence_account import EvidenceGap
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


def test_the_line_says_what_is_lost_how_long_it_fits_and_what_comes() -> None:
    evidence = EvidenceView((camera("left", 12), camera("right")), True, 48_000_000, 11 * 3600.0)
    before = replace(evidence, topics=(camera("left"),), recording=False)
    assert drawn(before) == (
        "evidence  room for 11 h  1 topic 6.1 MB/s  camera/left 29.8 Hz 6.1 MB/s"
    )
    assert drawn(evidence) == (
        "evidence  camera/left 12 lost  room for 11 h  2 topics 12.2 MB/s  48 MB recorded"
        "  camera/right 29.8 Hz 6.1 MB/s"
    )


@pytest.mark.parametrize("width", [46, 78, 80, 116])
def test_what_lacks_something_comes_first_then_the_room(width: int) -> None:
    sides = [camera(f"c{number}") for number in range(8)] + [camera("worst", 3)]
    text = drawn(EvidenceView(tuple(sides), True, 0, 60.0), width)
    assert text.startswith("evidence  camera/worst 3 lost  room for 60 s")
    assert ("9 topics 54.9 MB/s" in text) is (width >= 78)


@pytest.mark.parametrize("width", [60, 80, 116])
def test_of_many_that_lack_something_the_silent_ones_come_first_and_the_rest_is_counted(
    width: int,
) -> None:
    poor = [camera(f"c{number}", number + 1) for number in range(8)]
    silent = camera("worst", problem="silent since 12:03:04")
    text = drawn(EvidenceView((*poor, silent), True, 0, 5400.0), width)
    assert text.startswith("evidence  camera/worst silent")
    assert "more" in text
    assert "room for 90 min" in text


def test_when_nothing_was_recorded_stays_on_the_line_and_numbers_say_at_least() -> None:
    gaps = (EvidenceGap(5.62, 8.35, "it was ended by SIGKILL"),)
    evidence = EvidenceView((camera("left", 12),), True, 48_000_000, 5.0, gaps=gaps)
    assert drawn(evidence, 80) == (
        "evidence  missing from +5.6 s to +8.3 s  camera/left 12+ lost  room for 5 s"
    )
    more = replace(
        evidence, gaps=(*gaps, EvidenceGap(20.0, 23.0, "it hangs")), topics=(camera("left"),)
    )
    assert drawn(more, 80).startswith("evidence  missing 2 times  room for 5 s")


def test_where_there_is_no_room_for_names_topics_that_lack_something_are_counted() -> None:
    gaps = (EvidenceGap(5.62, 8.35, "it was ended by SIGKILL"),)
    topics = tuple(camera(f"c{number}", 4) for number in range(3))
    evidence = EvidenceView(topics, True, 48_000_000, 3 * 3600.0, gaps=gaps)
    assert drawn(evidence, 78) == (
        "evidence  missing from +5.6 s to +8.3 s  3 topics lack some  room for 3 h"
    )


def test_without_a_wish_there_is_no_line_and_what_is_wrong_with_all_of_it_is_said() -> None:
    assert drawn(None) == ""
    assert drawn(EvidenceView()) == "evidence  none of its topics is there"
    problem = "the evidence process is started again: it was ended by SIGKILL"
    assert drawn(EvidenceView(problem=problem)) == f"evidence  {problem}"


def test_what_has_no_room_is_cut_with_a_sign() -> None:
    problem = "the evidence process is started again: it was ended by SIGKILL"
    assert drawn(EvidenceView(problem=problem), 40) == "evidence  the evidence process is start…"
    silent = camera("hall_3/above_the_door/left", problem="silent for 42 s")
    view = EvidenceView((silent, camera("right")), True, 0, 60.0)
    told = "evidence  camera/hall_3/above_the_door/left silent for 42 s  room for 60 s"
    assert drawn(view, 78) == told
