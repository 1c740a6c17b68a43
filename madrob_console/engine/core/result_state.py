"""The current run's result: requested, made, written, and shown as soon as it is on disk."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from madrob_console.engine.core.effects import Effect, Score
from madrob_console.engine.core.scored_run import RenderedResult, ScoringRequest
from madrob_console.referee.flags import NO_INDICATORS
from madrob_console.referee.records import JournalMark
from scoring.indicator_table import IndicatorName
from scoring.result import Indicator

NOTICEABLE = 0.3
"""An outdated result stays on screen this long while the next one is made, s."""


class ResultState:
    """What is known of the current run's result.

    Attributes:
        scored: the result, once it can be shown.
        problem: why that is not on disk, in words.
        awaited: the latest request, until its result can be shown.
    """

    def __init__(self) -> None:
        self.scored: RenderedResult | None = None
        self.problem: str | None = None
        self.awaited: ScoringRequest | None = None
        self._awaited_since = 0.0

    @property
    def indicators(self) -> Mapping[IndicatorName, Indicator]:
        return NO_INDICATORS if self.scored is None else self.scored.result.indicators

    @property
    def is_wanted(self) -> bool:
        """Whether there is a result, or one is being made."""
        return self.scored is not None or self.awaited is not None

    @property
    def is_missing(self) -> bool:
        """Whether the first result is being made."""
        return self.scored is None and self.awaited is not None

    @property
    def is_settled(self) -> bool:
        return self.scored is not None and self.awaited is None

    def is_outdated(self, monotonic: float) -> bool:
        """Whether a newer result is wanted and takes a while."""
        return self.awaited is not None and monotonic - self._awaited_since > NOTICEABLE

    def request(self, wanted: ScoringRequest, mark: JournalMark, monotonic: float) -> Effect:
        """Request the result; replaces an earlier request."""
        if self.awaited is None:
            self._awaited_since = monotonic
        self.awaited = replace(wanted, run=replace(wanted.run, journal=mark))
        return Score(self.awaited)

    def show(self, wanted: ScoringRequest, scored: RenderedResult) -> bool:
        """Show a result; False where a newer one is awaited."""
        if wanted is not self.awaited:
            return False
        self.scored, self.awaited = scored, None
        return True
