"""Evidence as the engine sees it."""

from __future__ import annotations

import msgspec

from madrob_console.referee.evidence_account import EvidenceStatus


class EvidencePlace(msgspec.Struct, frozen=True):
    """Where the evidence of a run goes.

    Attributes:
        folder: of the bag.
        steady_ns: steady time now (protocol section 8).
        monotonic_ns: the machine's monotonic time at the same moment.
        most_bytes: what is left of the budget.
        least_free: bytes that stay free on the disk, for scoring.
    """

    folder: str
    steady_ns: int
    monotonic_ns: int
    most_bytes: int
    least_free: int


class EvidenceClient:
    """Records evidence beside the engine: this one none. Nothing waits; calls are the core's."""

    @property
    def status(self) -> EvidenceStatus | None:
        """None = no evidence is wanted, or there can be none."""
        return None

    def warm(self) -> None:
        """Get ready: topics shall be found before the first start."""

    def begin_recording(self, place: EvidencePlace) -> None:
        """It goes on until `end_recording`."""

    def end_recording(self) -> None:
        """Nothing more is recorded."""

    def await_account(self, limit: float) -> None:
        """Wait until all that was recorded is counted, `limit` s at most; not for the core."""

    def hold_writing(self, *, held: bool) -> None:
        """Leave the disk to scoring."""

    def close(self) -> None:
        """End it; the recording gets complete by itself."""
