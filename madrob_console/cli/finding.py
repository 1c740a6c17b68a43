"""A finding of the doctor, and its line."""

from __future__ import annotations

from dataclasses import dataclass
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
    """

    severity: Severity
    subject: str
    text: str


def line(finding: Finding) -> str:
    return f"{finding.severity.name.lower():7}  {finding.subject:{SUBJECT_WIDTH}}  {finding.text}"
