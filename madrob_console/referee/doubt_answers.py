"""Doubts on a result (protocol section 11): which the referee has accepted, and which wait."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypeAlias

from madrob_console.referee.on_record import AcceptedDoubts
from scoring.indicator_table import IndicatorName
from scoring.result import Indicator

Doubts: TypeAlias = dict[IndicatorName, tuple[str, ...]]
"""Sentences by indicator; those without are missing."""

MOST_NAMED = 4
"""Indicators; more of them are counted."""


def waiting_doubts(
    indicators: Mapping[IndicatorName, Indicator], accepted: Iterable[AcceptedDoubts]
) -> Doubts:
    """The doubts that the referee has not accepted.

    Args:
        indicators: of the result as it is now.
        accepted: what the referee has accepted; of a result that was another one only the
            sentences that still stand say something.
    """
    passed = {
        (name, words)
        for one in accepted
        for name, sentences in one.doubts.items()
        for words in sentences
    }
    found = {
        name: tuple(words for words in one.doubts if (name, words) not in passed)
        for name, one in indicators.items()
    }
    return {name: sentences for name, sentences in found.items() if sentences}


def doubted_words(found: Mapping[IndicatorName, tuple[str, ...]]) -> str:
    """Which indicators are doubted: `execution time, passage time`; of many the first."""
    names = [name.words for name in found]
    more = len(names) - MOST_NAMED
    if more <= 1:
        return ", ".join(names)
    return f"{', '.join(names[:MOST_NAMED])} and {more} more"
