"""A finding of the doctor, and its line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

SUBJECT_WIDTH = len("/madrob/passage/ccw_right")


class Severity(IntEnum):
    """How bad a finding is."""

    OK = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that the doctor checked.

    Attributes:
        severity: WARNING = the console runs, but look at it; ERROR = it does not run.
        text: what was found and, unless all is well, the remedy; one line.
        runs: those it is about by their places, each with the words for it.
    """

    severity: Severity
    subject: str
    text: str
    runs: Mapping[str, str] = field(default_factory=dict)


def line(finding: Finding, width: int = SUBJECT_WIDTH) -> str:
    """`width` is that of the subject."""
    return f"{finding.severity.name.lower():7}  {finding.subject:{width}}  {finding.text}"
