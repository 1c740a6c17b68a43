"""What `madrob score` says of one run: plain text, so that another process can do the work."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from madrob_console.archive.run_paths import RunPath
from madrob_console.errors import MadrobError
from madrob_console.names import terminal_safe
from scoring.rulesets import RulesetName

if TYPE_CHECKING:
    from madrob_console.archive.rescore import ScoredPath


@dataclass(frozen=True, slots=True)
class Wanted:
    """What to say of every run.

    Attributes:
        rules: the rulesets, each once; None = that of the run.
        check: compare with the stored result instead.
        as_json: for programs instead of people.
    """

    rules: tuple[RulesetName | None, ...] = (None,)
    check: bool = False
    as_json: bool = False


@dataclass(frozen=True, slots=True)
class Told:
    """What there is to say of one run.

    Attributes:
        text: lines for people, or one JSON document; empty where there is a problem.
        problem: why it cannot be scored, on one line; None = it can.
        differs: a check found a difference.
    """

    text: str
    problem: str | None = None
    differs: bool = False


def tell(run: RunPath, wanted: Wanted) -> Told:
    """Score or check a run. Never raises: one bad run must not stop the others."""
    try:
        return _checked(run, wanted) if wanted.check else _scored(run, wanted)
    except MadrobError as error:
        return Told("", str(error))
    except Exception as error:  # noqa: BLE001  # a fault of ours must not stop the others either
        return Told("", f"{run.name}: cannot be scored ({error!r}): please report it")


def _scored(run: RunPath, wanted: Wanted) -> Told:
    # they load numpy and SciPy, which a program that only hands out work does without
    from madrob_console.archive.rescore import score_run
    from madrob_console.cli.score_table import comparison_lines, result_lines

    scored = score_run(run, wanted.rules)
    if wanted.as_json:
        return Told(_json(run, _document(scored)))
    results = [one.result for one in scored]
    lines = result_lines(*results) if len(results) == 1 else comparison_lines(results)
    return Told("\n".join([terminal_safe(run.name), *(f"  {line}" for line in lines)]))


def _document(scored: tuple[ScoredPath, ...]) -> dict[str, Any]:
    from madrob_console.archive.results import scores
    from madrob_console.cli.score_table import difference

    if len(scored) == 1:
        return scores(scored[0].result)
    first, *others = (each.result for each in scored)
    differences: dict[str, Any] = {}
    for one in first.indicators:
        by = {other.ruleset: difference(one, other.indicator(one.name)) for other in others}
        differences[one.name] = by if len(others) > 1 else next(iter(by.values()))
    return {
        "rulesets": {result.ruleset: scores(result) for result in (first, *others)},
        "differences": differences,
    }


def _checked(run: RunPath, wanted: Wanted) -> Told:
    from madrob_console.archive.check import check_run

    found = check_run(run)
    if wanted.as_json:
        return Told(_json(run, {"differences": found}), differs=bool(found))
    verdict = f"differs in {len(found)}" if found else "agrees"
    lines = [f"{run.name}: {verdict}", *(f"  {difference.words}" for difference in found)]
    return Told("\n".join(map(terminal_safe, lines)), differs=bool(found))


def _json(run: RunPath, content: dict[str, Any]) -> str:
    import msgspec

    document = msgspec.json.encode({"path": run.name} | content)
    return msgspec.json.format(document, indent=2).decode()
