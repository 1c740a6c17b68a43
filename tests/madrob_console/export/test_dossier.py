"""What the first file of a dossier says."""

from __future__ import annotations

from madrob_console.export.dossier import protest_lines
from madrob_console.referee.evidence_account import (
    EvidenceAccount,
    EvidenceGap,
    EvidenceLoss,
    RecordedTopic,
)
from madrob_console.referee.on_record import RemovedEvidence
from madrob_console.referee.run import Run

CAMERA = RecordedTopic("/camera/c1", "raw/Type", 90, 4_000_000, 0, {EvidenceLoss.BEHIND: 14})


def told(**fields: object) -> list[str]:
    return list(protest_lines(Run(**fields), "the_run"))  # type: ignore[arg-type]


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
