"""A live number is the final number, or it is marked as one that may still change.

`pytest -m slow tests/madrob_console/ui/test_live_numbers.py --runs 300 -n 0 -s` runs more.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from madrob_console.engine.shown.snapshot import Snapshot
from madrob_console.testbeds.simulated import Scenario
from madrob_console.ui.cells.lines import Line
from madrob_console.ui.frame.wall import wall_steps
from madrob_console.ui.look.words import ROUGH
from madrob_console.ui.panes.provisional import Provisional
from madrob_console.ui.panes.step_table import result_step_lines, step_lines
from scoring.indicator_table import IndicatorName
from scoring.protocol import Condition
from scoring.result import Result
from scoring.rulesets import RulesetName
from tests.madrob_console.engine.drive import STEP, Drive, make_setup

LOOK = 0.1
"""s between two looks at the screen."""

TIMEOUT = 40.0
NARROW, WIDE = 30, 160
_INDICATORS = {
    "to handle": IndicatorName.TIME_TO_HANDLE,
    "occupation": IndicatorName.DOOR_OCCUPATION_TIME,
    "passage": IndicatorName.PASSAGE_TIME,
}
_INDICATOR = re.compile(rf"({'|'.join(_INDICATORS)}) (~?[\d.]+) s")
_STEP = re.compile(r"(\d) [a-z ]+? +(~?[\d.]+)")


@dataclass(slots=True)
class Followed:
    """One number on its way: each text that stood there, in order; empty = none did."""

    texts: list[str] = field(default_factory=list)

    def note(self, text: str) -> None:
        """It stands so now."""
        if (self.texts[-1] if self.texts else "") != text:
            self.texts.append(text)


@dataclass(frozen=True, slots=True)
class Changes:
    """Of some numbers: how many were shown, how many changed afterwards, and by how much at most.

    Attributes:
        gone: how many of the changed ones have no value in the end.
        most: s; of those that have.
    """

    shown: int = 0
    changed: int = 0
    gone: int = 0
    most: float = 0.0

    def __add__(self, other: Changes) -> Changes:
        return Changes(
            self.shown + other.shown,
            self.changed + other.changed,
            self.gone + other.gone,
            max(self.most, other.most),
        )

    def __str__(self) -> str:
        return f"{self.shown:6} {self.changed:8} {self.gone:5} {self.most:9.3f}"


def texts(lines: Iterable[Line]) -> Iterator[str]:
    for row in lines:
        yield "".join(span.text for span in row)


def shown(snapshot: Snapshot) -> dict[str, str]:
    """The times on the live screen and on the wall, as they stand there, by what they are of."""
    found: dict[str, str] = {}
    for text in texts(Provisional().draw(snapshot, WIDE)):
        found |= dict(_INDICATOR.findall(text))
    settled = snapshot.result is not None
    table = step_lines(snapshot.steps, snapshot.run.start, NARROW, settled=settled)
    for place, rows in (("step", table), ("wall", wall_steps(snapshot, NARROW))):
        for text in texts(rows):
            found |= {f"{place} {number}": time for number, time in _STEP.findall(text)}
    return found


def final(result: Result) -> dict[str, str]:
    """The same in the result."""
    found = {}
    for words, name in _INDICATORS.items():
        value = result.indicators[name].value
        found[words] = "" if value is None else f"{value:.3f}"
    for text in texts(result_step_lines(result.steps, result.start, NARROW)):
        for number, time in _STEP.findall(text):
            found |= {f"{place} {number}": time for place in ("step", "wall")}
    return found


def follow(drive: Drive, ruleset: RulesetName, condition: Condition) -> dict[str, Followed]:
    """Let a run go on to its result and look at the screens all the while."""
    followed: dict[str, Followed] = {}
    drive.start(make_setup(condition, timeout=TIMEOUT, ruleset=ruleset))
    while drive.engine.scored is None:
        snapshot = drive.engine.snapshot()
        now = shown(snapshot)
        for name in followed.keys() | now.keys():
            followed.setdefault(name, Followed()).note(now.get(name, ""))
        for _ in range(round(LOOK / STEP)):
            drive.engine.step(STEP)
    return followed


def changes(texts: Sequence[str], end: str, *, marked: bool) -> Changes:
    """What became of what was shown with the mark, or without it, of one number."""
    told = [text for text in texts if text and text.startswith(ROUGH) is marked]
    if not told:
        return Changes()
    values = [float(text.removeprefix(ROUGH)) for text in told]
    if not end:
        return Changes(1, 1, 1)
    rounding = 0.0501 if marked else 0.0
    off = max(abs(value - float(end)) for value in values)
    return Changes(1, int(off > rounding), 0, off if off > rounding else 0.0)


def of_run(
    results: Path, scenario: Scenario, seed: int, ruleset: RulesetName, *, latch: bool
) -> tuple[Changes, Changes]:
    """Of the numbers without a mark, and of those with it, in one run."""
    drive = Drive(results, scenario, seed, latch=latch)
    followed = follow(drive, ruleset, Condition.from_number(1 + seed % 20))
    assert drive.engine.scored is not None
    end = final(drive.engine.scored.result)
    drive.engine.close()
    settled, marked = (
        sum(
            (changes(f.texts, end.get(name, ""), marked=mark) for name, f in followed.items()),
            Changes(),
        )
        for mark in (False, True)
    )
    return settled, marked


@pytest.mark.parametrize("scenario", [Scenario.NOMINAL, Scenario.BOUNCES, Scenario.TURNS_BACK])
def test_a_time_without_a_mark_is_the_one_of_the_result(scenario: Scenario, tmp_path: Path) -> None:
    settled, marked = of_run(tmp_path, scenario, 3, RulesetName.PROTOCOL, latch=False)
    assert settled.shown
    assert settled.changed == 0
    assert marked.shown or scenario is Scenario.TURNS_BACK


@pytest.mark.slow
def test_no_time_without_a_mark_changes_in_any_scenario(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """`--runs` runs of each scenario, by each ruleset in turn, every other one with a latch."""
    runs = max(1, request.config.getoption("--runs") // len(Scenario))
    rulesets = list(RulesetName)
    head = f"{'shown':>6} {'changed':>8} {'gone':>5} {'by s':>9}"
    rows = [f"{'':22}{'without a mark':>31}  {'with a mark':>31}", f"{'':22}{head}  {head}"]
    whole = [Changes(), Changes()]
    for number, scenario in enumerate(Scenario):
        total = [Changes(), Changes()]
        for seed in range(number, number + runs):
            place = tmp_path / f"{scenario}_{seed}"
            ruleset = rulesets[seed % len(rulesets)]
            found = of_run(place, scenario, seed, ruleset, latch=bool(seed // 2 % 2))
            total = [one + other for one, other in zip(total, found, strict=True)]
        whole = [one + other for one, other in zip(whole, total, strict=True)]
        rows.append(f"{scenario:22}{total[0]}  {total[1]}")
    rows.append(f"{'all':22}{whole[0]}  {whole[1]}")
    print("\n".join(["", *rows]))
    assert whole[0].shown
    assert whole[0].changed == 0
