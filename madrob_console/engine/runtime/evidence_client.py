"""The evidence recording as the engine uses it."""

from __future__ import annotations

import msgspec

from madrob_console.referee.evidence_state import EvidenceState


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
    """Records evidence beside the engine: this one none. The core calls it, and never waits."""

    @property
    def state(self) -> EvidenceState | None:
        """None = no evidence is wanted, or there can be none."""
        return None

    def warm(self) -> None:
        """Discover the topics before the first start."""

    def begin_recording(self, place: EvidencePlace) -> None:
        """It goes on until `end_recording`."""

    def end_recording(self) -> None:
        """Nothing more is recorded."""

    def await_account(self, limit: float) -> None:
        """Wait until all that was recorded is in its file, `limit` s at most; not for the core."""

    def hold_writing(self, *, held: bool) -> None:
        """Leave the disk to scoring."""

    def close(self) -> None:
        """End it; its process finishes the file alone."""
