"""What a run's account says of its evidence once the files are whole."""

from __future__ import annotations

import pytest

from madrob_console.referee.evidence_account import EvidenceAccount, EvidenceGap


@pytest.mark.parametrize(
    ("told", "spans", "found"),
    [
        # from the last message of the file before it
        ((3.0, 5.0), [(0.0, 3.4), (4.8, 9.0)], (3.4, 5.0)),
        # to the first message after it, which came later than expected
        ((3.0, 5.0), [(0.0, 3.4), (5.9, 9.0)], (3.4, 5.9)),
        # nothing came after it
        ((3.0, 5.0), [(0.0, 3.4)], (3.4, 5.0)),
        ((3.0, None), [(0.0, 3.4)], (3.4, None)),
    ],
)
def test_a_gap_is_at_least_what_lies_between_two_files(
    told: tuple[float, float | None],
    spans: list[tuple[float, float]],
    found: tuple[float, float | None],
) -> None:
    account = EvidenceAccount(gaps=(EvidenceGap(*told, "ended by SIGKILL"),))
    (gap,) = account.settled({}, spans=spans).gaps
    assert (gap.begin, gap.end) == found
