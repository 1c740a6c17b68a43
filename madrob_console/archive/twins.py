"""Runs that are there several times: which place of each counts (protocol section 2)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RunPlace:
    """Where a run with a usable result lies.

    Attributes:
        name: of the place, unlike any other.
        run_id: of the run; empty = not known, so that it is like no other.
        practice: whether it counts for nothing there.
        issue: of the result there.
    """

    name: str
    run_id: str
    practice: bool
    issue: int


def places_that_count(places: Iterable[RunPlace]) -> dict[str, str]:
    """By `run_id`, the name of the place that counts: official, of the latest issue, the first."""
    kept: dict[str, RunPlace] = {}
    for place in places:
        other = kept.get(place.run_id)
        if place.run_id and (other is None or _rank(place) > _rank(other)):
            kept[place.run_id] = place
    return {run_id: place.name for run_id, place in kept.items()}


def _rank(place: RunPlace) -> tuple[bool, int]:
    return not place.practice, place.issue


def why_twin(place: str, counting: str) -> str:
    """Why the run at a place does not count although it is valid, in words."""
    return f"{place} is the same run as {counting}, which counts"
