"""What the first file of a dossier says."""

from __future__ import annotations

from dataclasses import replace

import pytest

from madrob_console.export.dossier import protest_lines
from madrob_console.referee.evidence_account import (
    EvidenceAccount,
    EvidenceGap,
    EvidenceLoss,
    RecordedTopic,
)
from madrob_console.referee.on_record import RemovedEvidence
from madrob_console.referee.protests import Protest
from madrob_console.referee.run import Run
from tests.madrob_console.engine.drive import make_setup

NOW = 1_790_000_000.0
CAMERA = RecordedTopic("/camera/c1", "raw/Type", 90, 4_000_000, 0, {EvidenceLoss.BEHIND: 14})


def told(**fields: object) -> list[str]:
    return list(protest_lines(Run(**fields), "the_run", NOW))  # type: ignore[arg-type]


def test_who_decides_a_protest_reads_what_of_the_evidence_is_missing_and_when() -> None:
    gaps = EvidenceGap(6.7, 8.6, "the process ended"), EvidenceGap(20.0, None, "the disk")
    lines = told(evidence=EvidenceAccount((CAMERA,), gaps=gaps))
    lost = "at least 14 lost, missing from +6.7 s to +8.6 s and 1 time more"
    assert lines[-3:] == [
        f"Evidence: 1 topic, 90 messages, 4.0 MB, {lost}",
        "  missing from +6.7 s to +8.6 s, from +20.0 s to the end",
        "  /camera/c1: at least 14 lost (14 behind)",
    ]


def test_evidence_that_was_removed_is_called_so() -> None:
    lines = told(
        evidence=EvidenceAccount((CAMERA,)), removed_evidence=(RemovedEvidence(0.0, 1, 5),)
    )
    assert "  removed by tidy on 1970-01-01 00:00:00 UTC" in lines


def test_a_run_without_evidence_says_nothing_of_it() -> None:
    assert not any("vidence" in line for line in told())


def filed(due: float, about: str = "7.500 s") -> Protest:
    at = 107.5
    return Protest(1, at, "Graz", "too late", about, at, due, "", "R. Eferee")


def test_an_open_protest_says_when_it_is_due_or_since_when_it_is_overdue() -> None:
    lines = told(protests=(filed(NOW + 60.0), filed(NOW - 60.0)), start=100.0)
    assert [line for line in lines if "OPEN" in line] == [
        "  OPEN: the decision is due by 2026-09-21 14:14:20 UTC",
        "  OPEN: the decision is OVERDUE since 2026-09-21 14:12:20 UTC",
    ]


def test_a_time_that_a_protest_is_about_is_told_once() -> None:
    lines = told(protests=(filed(NOW), filed(NOW, "step 4")), start=100.0)
    assert [line.split(maxsplit=1)[1] for line in lines if "about:" in line] == [
        "7.500 s from the start",
        "step 4, 7.500 s from the start",
    ]


@pytest.mark.parametrize(("team", "whose"), [("", "subject 3"), ("Graz", "subject 3 Graz")])
def test_whose_run_it_is_stands_below_the_title(team: str, whose: str) -> None:
    assert told(setup=replace(make_setup(), team=team))[1].startswith(
        f"Run 1 of {whose}, condition "
    )
