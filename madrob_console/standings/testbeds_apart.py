"""In what testbeds differ whose runs stand beside each other."""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence

import msgspec

from madrob_console.archive.history import RunSummary
from scoring.protocol import Thresholds


def how_testbeds_differ(runs: Iterable[RunSummary]) -> str:
    """In what the testbeds of the valid runs differ, in a sentence; empty = in nothing.

    Compared are the rulesets, the numbers of the settings (`thresholds`) and the rates at which the
    door was sampled, as far as results tell them.
    """
    of: dict[str, list[RunSummary]] = defaultdict(list)
    for run in runs:
        if run.valid:
            of[run.testbed].append(run)
    if len(of) < 2:
        return ""
    told = {name or "(no name)": dict(_told(of[name])) for name in sorted(of)}
    keys = dict.fromkeys(key for known in told.values() for key in known)
    differing = [words for key in keys if (words := _differing(key, told))]
    return f"The testbeds differ: {'; '.join(differing)}." if differing else ""


def _differing(key: str, told: Mapping[str, Mapping[str, str]]) -> str:
    """What each testbed has, where not all that are known have the same."""
    known = {name: having[key] for name, having in told.items() if key in having}
    if len(set(known.values())) < 2:
        return ""
    return f"{key} {', '.join(f'{value} ({name})' for name, value in known.items())}"


def _told(runs: Sequence[RunSummary]) -> Iterator[tuple[str, str]]:
    """What is known of one testbed, in words."""
    yield "ruleset", " and ".join(sorted({run.ruleset for run in runs}))
    rates = [run.rate for run in runs if run.rate is not None]
    if rates:
        yield "sampling rate", f"{statistics.median(rates):.0f} Hz"
    unlike = [run.thresholds for run in runs if run.thresholds is not None]
    if unlike:
        for name, usual in msgspec.to_builtins(Thresholds()).items():
            values = {_text(one.get(name, usual), usual) for one in unlike}
            yield name, " and ".join(sorted(values))


def _text(value: object, usual: object) -> str:
    """A number of the settings; of those that are several ones, what is another."""
    match value, usual:
        case dict(), dict():
            other = (f"{name} {value[name]:g}" for name in value if value[name] != usual.get(name))
            return " ".join(other) or "as the protocol"
        case list() | tuple(), _:
            return "/".join(f"{one:g}" for one in value)
        case float() | int(), _:
            return f"{value:g}"
    return str(value)
