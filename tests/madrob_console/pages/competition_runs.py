"""A competition's runs in a results folder, and its pages made of them by the command."""

from __future__ import annotations

import shutil
from pathlib import Path

from madrob_console.archive.folders import REPORT_FILE
from madrob_console.cli.main import main
from madrob_console.referee.run_summary import RunSummary
from scoring.indicator_table import IndicatorName
from scoring.protocol import Outcome
from scoring.result import Uncertainty
from tests.madrob_console.recorded_runs import completed
from tests.madrob_console.run_folders import UNDECIDED_START, VALUES, summary

TIME, LEVEL = IndicatorName.EXECUTION_TIME, IndicatorName.CAPABILITY_LEVEL
SMOOTH = IndicatorName.SMOOTHNESS_OF_DOOR_ACTUATION
HOSTILE = '<script>alert(1)</script>"&\x1b[31m\u202e'
CUP = "Autumn Cup"


def of(subject: int, number: int = 1, condition: int = 7, **fields: object) -> RunSummary:
    """A run, `number` hours after the first ones, with values of its own."""
    own = {TIME: 10.0 + subject, **dict(fields.pop("own", {}))}  # type: ignore[call-overload]
    fields.setdefault("values", {**VALUES, **own})
    return summary(subject, condition, number, hour=number + subject / 10, **fields)


RUNS = (
    of(1, uncertainties={TIME: Uncertainty(0.005, 0.01)}, final=True, team_word="protested"),
    of(1, 2, flags=(UNDECIDED_START,)),
    of(1, 3, outcome=Outcome.ABORTED, values={}, reason="a child ran in"),
    of(2, outcome=Outcome.TIMEOUT, own={LEVEL: 4, SMOOTH: 539.5}),
    of(3, own={SMOOTH: 3.9}, doubts={SMOOTH: 1}),
    of(3, 2, voided=True),
    of(3, 1, condition=12, team=HOSTILE),
    of(4, source="simulated", team="Rehearsal"),
)
FOREIGN_REPORT = (
    '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
    '<meta http-equiv="refresh" content="0;url=http://evil.example/"><base href="http://evil/">'
    '</head><body><form action="http://evil/"></form><a HREF="javascript:alert(1)">run 1</a>'
    "</body></html>"
)
"""As ours begin, and not ours: anybody who may write into a run's folder may have put it there."""


def put_recorded(results: Path, competition: str = CUP) -> tuple[Path, Path]:
    """Two recorded practice runs of team 3, with reports that somebody else wrote."""
    folders = (completed(1, competition), completed(2, competition))
    copies = (results / "practice" / folders[0].name, results / "practice" / folders[1].name)
    for folder, copy in zip(folders, copies, strict=True):
        shutil.copytree(folder, copy)
        (copy / REPORT_FILE).write_text(FOREIGN_REPORT)
    return copies


def publish_code(results: Path, *options: object, site: str = "site") -> int:
    """Publish them; returns the exit code."""
    chosen = results.parent / "madrob.toml"
    chosen.write_text(f'[competition]\nname = "{CUP}"\n')
    plan = results.parent / "plan.csv"
    where = (
        "--results",
        results,
        "--settings",
        chosen,
        *(("--plan", plan) if plan.exists() else ()),
    )
    return main(["publish", str(results.parent / site), *map(str, (*where, *options))])


def publish(results: Path, *options: object, site: str = "site") -> Path:
    """Publish them; returns the folder of the site."""
    assert publish_code(results, *options, site=site) == 0
    return results.parent / site


def stamps(site: Path) -> dict[str, tuple[int, int]]:
    """When each file was written, and which it is."""
    found = (path for path in site.rglob("*") if path.is_file())
    return {str(p.relative_to(site)): (p.stat().st_mtime_ns, p.stat().st_ino) for p in found}
