from __future__ import annotations

import os
import threading

import pytest

from madrob_console.preparing.doctor_evidence import PATIENCE, look_at_evidence
from madrob_console.preparing.finding import Finding, Severity
from madrob_console.testbeds.evidence_choice import EvidenceChoice
from tests.madrob_console.camera_peer import Kind, Stream, cameras
from tests.madrob_console.ros_peer import BOOL, Peer

HALL = Stream(Kind.JPEG, count=2, rate=20, size=50_000, reliable=True)


def looked(*topics: str, own: tuple[str, ...] = (), domain: int = 0) -> dict[str, Finding]:
    choice = EvidenceChoice(topics)
    found = look_at_evidence(choice, own, domain, 100 * 10**9, os.environ)
    return {finding.subject: finding for finding in found}


def test_without_a_wish_nothing_is_looked_for() -> None:
    (finding,) = looked().values()
    assert finding == Finding(Severity.OK, "evidence", "none is wanted: setting `recording.topics`")


@pytest.mark.machine
def test_what_matches_now_is_shown_with_its_rate_and_what_an_hour_costs(
    ros_domain: int, peer: Peer
) -> None:
    left, right = HALL.topics
    with cameras(HALL):
        peer.until(lambda: peer.own.count_publishers(left))
        found = looked("/camera/**", own=(right,), domain=ros_domain)
    assert right not in found  # it is recorded anyway
    assert found[left].text.startswith(f"evidence, {HALL.kind.type}, ")
    assert found[left].severity is Severity.OK
    assert "1 topic, " in found["evidence"].text
    assert " GB an hour, the budget of 100 GB is " in found["evidence"].text


@pytest.mark.machine
def test_patterns_that_match_nothing_are_said(ros_domain: int) -> None:
    finding = looked("/camera/**", domain=ros_domain)["evidence"]
    assert finding.severity is Severity.WARNING
    assert finding.text.startswith(f"nobody publishes /camera/**, not seen within {PATIENCE:g} s: ")


@pytest.mark.machine
def test_what_is_recorded_with_the_score_needs_no_pattern(ros_domain: int) -> None:
    found = looked("/madrob/**", own=("/madrob/door", "/madrob/handle"), domain=ros_domain)
    said = "/madrob/**: recorded with the score, remove the pattern"
    assert found == {"evidence": Finding(Severity.WARNING, "evidence", said)}


@pytest.mark.machine
def test_what_turns_up_late_is_waited_for(ros_domain: int) -> None:
    left, right = HALL.topics
    found: dict[str, Finding] = {}

    def look() -> None:
        found.update(looked(left, right, domain=ros_domain))

    looking = threading.Thread(target=look)
    looking.start()
    looking.join(4.0)
    with cameras(HALL):
        looking.join(30.0)
    assert {left, right} <= set(found)
    assert found["evidence"].severity is Severity.OK


@pytest.mark.machine
def test_a_pattern_that_matches_nothing_beside_one_that_does_is_said(
    ros_domain: int, peer: Peer
) -> None:
    silent = peer.publisher("/hall/silent", BOOL)
    peer.until(lambda: peer.own.count_publishers("/hall/silent"))
    choice = EvidenceChoice(("/hall/**", "/camera/**"))
    found = list(look_at_evidence(choice, (), ros_domain, 10**11, os.environ))
    assert silent is not None
    texts = [one.text for one in found if one.severity is Severity.WARNING]
    assert any(text.endswith(": nothing comes now") for text in texts)
    assert any(text.startswith("nobody publishes /camera/**, not seen within ") for text in texts)


@pytest.mark.machine
def test_large_pictures_that_are_lost_on_the_way_are_told_with_the_remedy(
    ros_domain: int, peer: Peer
) -> None:
    large = Stream(Kind.RAW, "/camera/raw", size=2_000_000)
    remedy = " lost on the way: have it published reliably, or "

    def told() -> bool:
        finding = looked("/camera/**", domain=ros_domain).get("/camera/raw")
        return finding is not None and remedy in finding.text

    with cameras(large):
        peer.until(lambda: peer.own.count_publishers("/camera/raw"))
        peer.until(told)  # what floods the way may hold up that it is found
