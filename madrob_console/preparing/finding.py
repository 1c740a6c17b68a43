"""What the doctor finds."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Severity(IntEnum):
    """How bad a finding is."""

    OK = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        severity: WARNING = the console runs, but look at it; ERROR = it does not run.
        subject: what was looked at, one or two words.
        text: what was found and, unless all is well, the remedy; one line.
    """

    severity: Severity
    subject: str
    text: str
