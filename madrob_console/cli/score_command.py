"""`madrob score`: recorded runs to results, one or ten thousand of them.

What is said of a run is plain text, so that another process can do the work.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import fields
from functools import partial
from pathlib import Path
from textwrap import indent
from typing import TYPE_CHECKING, Any, NamedTuple

from madrob_console.cli import batch, options
from madrob_console.cli.command_line import Argument, OneOf, command
from madrob_console.cli.output import BAD_INPUT, Complaints, complain, name_twins
from madrob_console.cli.parsing import as_path
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import terminal_safe, valid_text
from scoring.indicator_table import RulesetName

if TYPE_CHECKING:
    from madrob_console.archive.check import Grade
    from madrob_console.archive.run_paths import RunPath
    from madrob_console.archive.scored import ScoredPath
    from scoring.arrays import Evaluation

DIFFERENCES = 1
"""Exit code of `--check` if a result is not what its recording gives."""

_ALL = "all"
_WITHDRAWN = "withdrawn, no run"


class RunText(NamedTuple):
    """What is printed of one run.

    Attributes:
        text: lines for people, or one JSON document.
        values_hold: whether it differs in doubts only.
        uncertainties: whether some differ from the stored ones; no grade depends on them.
        run_id: empty = not known, or it does not matter.
    """

    text: str
    grade: Grade | None = None
    values_hold: bool = False
    uncertainties: bool = False
    run_id: str = ""


@command(
    "score",
    "score recorded runs, or check their stored results",
    "Folders of EUROBENCH csv files can be scored, too. Runs that are there twice are named. "
    "Exit code 2 when a run cannot be read; the rest is scored. With --check a result has the "
    "same digits as its recording gives, is equal to 1e-9 (other libraries round otherwise; "
    "it says which), or differs: exit code 1, also where only doubts differ; it says then that "
    "the values hold. Uncertainties that differ have a line of their own and no exit code.",
    options=(
        options.PATHS,
        options.COMPETITION,
        Argument(
            "--ruleset",
            choices=[*map(str, RulesetName), _ALL],
            help="the rules, or all side by side; those of the run if not given, protocol where "
            "EUROBENCH's files name none",
        ),
        OneOf(
            Argument(
                "--check",
                action="store_true",
                help="compare each run's result.json with what its recording gives",
            ),
            Argument(
                "--write",
                type=as_path,
                metavar="FOLDER",
                help="write EUROBENCH's files of each run (csv, condition, run_info, the "
                "indicators' YAML) into a new folder in FOLDER, called like the run, with "
                "--ruleset by these rules; the run's own folder stays as it is. run_info says by "
                "which rules the files were made and whether the run is practice or simulated; csv "
                "files without it say neither",
            ),
            Argument(
                "--reissue",
                metavar="REASON",
                help="after a rule change: each result that is another one now gets its next "
                "version, with a line in its journal; the one before stays, and so does what the "
                "referee decided. With --ruleset by these rules from now on. A final result is to "
                "be signed again, a void run stays void, an aborted one has no indicators and is "
                "left alone",
            ),
        ),
        options.JSON,
        Argument(
            "--dry-run",
            action="store_true",
            help="say what --reissue would change, write nothing",
        ),
        options.SETTINGS,
        *batch.SHARING,
    ),
    examples=(
        "madrob score ~/madrob_runs                  # all runs",
        "madrob score --ruleset all my_run           # all rulesets side by side",
        "madrob score --check ~/madrob_runs          # do the stored results hold?",
        "madrob score --write published --ruleset eurobench-2020 ~/madrob_runs",
        "madrob score --reissue 'rules of May' --ruleset eurobench-2020 --dry-run ~/madrob_runs",
    ),
)
def score(arguments: argparse.Namespace) -> int:
    _refuse_contradictions(arguments)
    runs = _chosen(batch.runs_of(arguments), arguments)
    rules = _rules(arguments.ruleset)
    if arguments.reissue is not None:
        from madrob_console.cli.reissuing import reissue
        from madrob_console.common.clock import SystemClock

        return reissue(arguments, runs, rules[0], SystemClock())
    return _describe(arguments, runs, rules)


def _chosen(runs: list[RunPath], arguments: argparse.Namespace) -> list[RunPath]:
    if arguments.competition is None:
        return runs
    from madrob_console.archive.collection import demand_competition
    from madrob_console.archive.result_reader import competition_of

    with_competition = [(run, competition_of(run.path)) for run in runs]
    for run, competition in with_competition:
        if competition is None:
            complain(f"note: {run.name}: does not say of which competition it is, left out")
    demand_competition(
        arguments.competition, {name for _, name in with_competition if name is not None}
    )
    return [run for run, competition in with_competition if competition == arguments.competition]


def _refuse_contradictions(arguments: argparse.Namespace) -> None:
    parser, issues = arguments.parser, arguments.reissue
    if arguments.ruleset is not None and arguments.check:
        parser.error("--ruleset: not allowed with --check")
    if issues is None and (arguments.dry_run or arguments.settings):
        parser.error(f"{'--dry-run' if arguments.dry_run else '--settings'}: only with --reissue")
    if arguments.write is not None and arguments.write.name in [*RulesetName]:
        raise MadrobError("--write takes a folder: name the rules with --ruleset")
    if arguments.ruleset == _ALL and (issues is not None or arguments.write is not None):
        parser.error(
            f"{'--write' if issues is None else '--reissue'}: with one ruleset, not {_ALL}"
        )
    if issues is not None and not issues.strip():
        parser.error("--reissue: give a reason, it stands in every journal")
    if arguments.json and issues is not None:
        parser.error("--json: not allowed with --reissue")


def _describe(
    arguments: argparse.Namespace, runs: Sequence[RunPath], rules: tuple[RulesetName | None, ...]
) -> int:
    from madrob_console.archive.check import Grade

    write = arguments.write
    if write is not None and arguments.scheduler is not None:  # as for the paths of the runs
        write = write.absolute()
    describe = partial(
        describe_run,
        rules=rules,
        check=arguments.check,
        write=write,
        as_json=arguments.json,
    )
    with Complaints() as bad, closing(batch.each_run(arguments, describe, runs, bad)) as texts:
        grades, held, unsure = _print(texts, as_json=arguments.json)
    if arguments.check and len(runs) > 1 and not arguments.json:
        only = f" ({held} only in doubts: the values hold)" if held else ""
        words_of_grade = {Grade.DIFFERS: f"differ{only}"}
        counts = (f"{grades[grade]} {words_of_grade.get(grade, grade)}" for grade in Grade)
        none = f", {grades[None]} {_WITHDRAWN}" if grades[None] else ""
        more = f"; of {unsure} the uncertainties differ" if unsure else ""
        print(f"{', '.join(counts)}, {bad.count} could not be checked{none}{more}")
    if grades[Grade.DIFFERS]:
        return DIFFERENCES
    return BAD_INPUT if bad.count else 0


def _rules(name: str | None) -> tuple[RulesetName | None, ...]:
    if name == _ALL:
        return tuple(RulesetName)
    return (None if name is None else RulesetName(name),)


def _print(
    texts: Iterable[tuple[RunPath, RunText | None]], *, as_json: bool
) -> tuple[Counter[Grade | None], int, int]:
    """Print the text of each run as soon as it is ready.

    Returns how many were of each grade, of how many that differ the values hold, and of how many
    the uncertainties differ.
    """
    grades: Counter[Grade | None] = Counter()
    held = unsure = 0
    met: dict[str, str] = {}
    same: list[tuple[str, str]] = []
    if as_json:
        print('{\n  "runs": [', end="")
    for run, text in texts:
        if text is None:
            continue
        if text.run_id and (first := met.setdefault(text.run_id, run.name)) != run.name:
            same.append((run.name, first))
        if as_json:
            before = "," if grades else ""
            print(before, indent(text.text, "    "), sep="\n", end="", flush=True)
        else:
            print(text.text, flush=True)
        grades[text.grade] += 1
        held += text.values_hold
        unsure += text.uncertainties
    if as_json:
        print("\n  ]\n}" if grades else "]\n}")
    name_twins(same)
    return grades, held, unsure


def describe_run(
    run: RunPath,
    rules: tuple[RulesetName | None, ...] = (None,),
    *,
    check: bool = False,
    write: Path | None = None,
    as_json: bool = False,
) -> RunText:
    """Score or check a run, or write its files by other rules.

    `rules` None = that of the run. MadrobError where it cannot be.
    """
    if write is not None:
        return _written(run, write, rules[0], as_json=as_json)
    return _checked(run, as_json=as_json) if check else _scored(run, rules, as_json=as_json)


def _scored(run: RunPath, rules: tuple[RulesetName | None, ...], *, as_json: bool) -> RunText:
    # they load numpy and SciPy, which a program that only hands out work does without
    from madrob_console.archive.scored import score_run
    from madrob_console.cli.result_lines import comparison_lines, result_lines

    scored = score_run(run, rules)
    if as_json:
        return RunText(_json(run, _document(scored)), run_id=scored[0].label.run_id)
    results = [each.result for each in scored]
    flags = scored[0].flags
    lines = (
        result_lines(results[0], flags) if len(results) == 1 else comparison_lines(results, flags)
    )
    text = "\n".join([terminal_safe(run.name), *(f"  {line}" for line in lines)])
    return RunText(text, run_id=scored[0].label.run_id)


def _document(scored: tuple[ScoredPath, ...]) -> dict[str, Any]:
    import msgspec

    from madrob_console.cli.result_lines import difference

    flags = {"flags": msgspec.to_builtins(scored[0].flags)}
    label: dict[str, Any] = msgspec.to_builtins(scored[0].label)
    if len(scored) == 1:
        return label | _content(scored[0].result) | flags
    first, *others = (each.result for each in scored)
    differences: dict[str, Any] = {}
    for name, indicator in first.indicators.items():
        by = {other.ruleset: difference(indicator, other.indicators[name]) for other in others}
        differences[name] = by if len(others) > 1 else next(iter(by.values()))
    return {
        **label,
        "rulesets": {result.ruleset: _content(result) for result in (first, *others)},
        "differences": differences,
        **flags,
    }


def _content(result: Evaluation) -> dict[str, Any]:
    """A result as `result.json` has it, without the set-up of the run."""
    import msgspec

    from scoring.result import Result

    names = (each.name for each in fields(Result) if each.name != "handle_zero")
    content: dict[str, Any] = msgspec.to_builtins({name: getattr(result, name) for name in names})
    return content


def _checked(run: RunPath, *, as_json: bool) -> RunText:
    from madrob_console.archive.check import check_run, is_withdrawn

    if is_withdrawn(run.path):
        text = _json(run, {"grade": _WITHDRAWN}) if as_json else f"{run.name}: {_WITHDRAWN}"
        return RunText(text if as_json else terminal_safe(text))
    checked = check_run(run)
    if as_json:
        text = _json(run, checked.content())
    else:
        differences = [each.words for each in checked.differences_of(checked.grade)]
        if checked.uncertainties:
            differences.append(checked.uncertainty_words)
        lines = [f"{run.name}: {checked.words}", *(f"  {words}" for words in differences)]
        text = "\n".join(map(terminal_safe, lines))
    return RunText(
        text,
        grade=checked.grade,
        values_hold=checked.values_hold,
        uncertainties=bool(checked.uncertainties),
    )


def _written(run: RunPath, target: Path, rules: RulesetName | None, *, as_json: bool) -> RunText:
    from madrob_console.archive.result_files import eurobench_files
    from madrob_console.archive.scored import score_recording
    from madrob_console.common.files import write_new_folder

    run.demand_recording()
    (scored,) = score_recording(run.path, (rules,))
    folder, used = target / run.own_name, scored.result.ruleset
    write_new_folder(folder, eurobench_files(run.own_name, scored))
    if as_json:
        return RunText(_json(run, {"written": str(folder), "ruleset": used}))
    return RunText(terminal_safe(f"{run.name}: written by {used} to {folder}"))


def _json(run: RunPath, content: dict[str, Any]) -> str:
    import msgspec

    document = msgspec.json.encode({"path": valid_text(run.name)} | content)
    return msgspec.json.format(document, indent=2).decode()
