"""How EUROBENCH names the files of a run (protocol section 10)."""

from __future__ import annotations

import re
from collections.abc import Iterable

_RUN_FILE = re.compile(
    r"(subject_([0-9]{1,9})_cond_([0-9]{1,9})_run_([0-9]{1,9}))_(event|jointState|wrench)\.csv"
)


def run_prefixes(names: Iterable[str]) -> list[str]:
    """How the names of each run's files begin, `subject_SSS_cond_CCC_run_RRR`, in order."""
    return sorted({match[1] for name in names if (match := _RUN_FILE.fullmatch(name))})


def numbers_of(prefix: str) -> tuple[int, int, int] | None:
    """The numbers of subject, condition and run; None for another text than a prefix."""
    match = _RUN_FILE.fullmatch(f"{prefix}_event.csv")
    return None if match is None else (int(match[2]), int(match[3]), int(match[4]))
