"""The doctor's findings about this machine: whether it can referee, and what to change."""

from __future__ import annotations

import codecs
import locale
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli.doctor_ros import look_at_ros
from madrob_console.cli.finding import Finding, Severity
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import counted, format_size
from madrob_console.engine.ipc.engine_sockets import no_state, state_folder
from madrob_console.referee.competition_plan import PlanSource, plan_remarks
from madrob_console.referee.team_list import TeamSource

if TYPE_CHECKING:
    from madrob_console.messages.mapping import TopicMapping


SMALLEST_TERMINAL = (80, 24)


def doctor(  # noqa: PLR0913  what it looks at
    mappings: Sequence[TopicMapping],
    results: Path,
    *,
    domain: int | None = None,
    disk_space: int,
    listen: float = 2.0,
    environment: Mapping[str, str] = os.environ,
    lists: Callable[[], Iterator[Finding]] = lambda: iter(()),
    evidence: Callable[[], Iterator[Finding]] = lambda: iter(()),
) -> Iterator[Finding]:
    """Check everything the console needs, one after the other; never raises.

    `domain` None = `ROS_DOMAIN_ID`, or 0. `disk_space` is in bytes. `listen` is how long to listen
    to the testbed, s, once it is found; 0 = not. Looking for it takes 3 s at most. `lists` and
    `evidence` check the competition's lists and what would be recorded beside the testbed's topics.
    """
    checks: tuple[tuple[str, Callable[[], Iterator[Finding]]], ...] = (
        ("python", look_at_python),
        ("results", lambda: look_at_results(results, disk_space)),
        ("lists", lists),
        ("terminal", lambda: look_at_terminal(environment)),
        ("state", lambda: iter((look_at_state_folder(),))),
        ("ros", lambda: look_at_ros(mappings, domain, listen, environment)),
        ("evidence", evidence),
    )
    for subject, check in checks:
        yield from _safely(subject, check)


def usable(findings: Sequence[Finding]) -> bool:
    return all(finding.severity is not Severity.ERROR for finding in findings)


def verdict(findings: Sequence[Finding]) -> str:
    if not usable(findings):
        return "not usable: see the errors above"
    warnings = sum(finding.severity is Severity.WARNING for finding in findings)
    return f"usable, {counted(warnings, 'warning')}" if warnings else "usable"


_OF_REPORTS = {"matplotlib": "matplotlib", "Pillow": "PIL"}


def look_at_python() -> Iterator[Finding]:
    version = ".".join(map(str, sys.version_info[:3]))
    yield Finding(Severity.OK, "python", f"{version}, {sys.prefix}")
    if missing := [name for name, module in _OF_REPORTS.items() if find_spec(module) is None]:
        text = f"no {' and '.join(missing)}: reports lack figures or pictures of cameras"
        yield Finding(Severity.WARNING, "python", f"{text}; install the extra `report`")


def look_at_results(folder: Path, disk_space: int) -> Iterator[Finding]:
    place = next((place for place in (folder, *folder.parents) if place.exists()), folder)
    if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
        yield Finding(
            Severity.ERROR, "results", f"{folder} cannot be written: set results.folder to another"
        )
        return
    free = shutil.disk_usage(place).free
    text = f"{folder}: {format_size(free)} free"
    if free < disk_space:
        needed = format_size(disk_space)
        yield Finding(Severity.WARNING, "results", f"{text}, less than {needed}: make room")
    else:
        yield Finding(Severity.OK, "results", text)


def look_at_terminal(environment: Mapping[str, str]) -> Iterator[Finding]:
    kind = environment.get("TERM", "")
    if not sys.stdout.isatty():
        yield Finding(Severity.OK, "terminal", "none: the output goes elsewhere")
    elif kind in ("", "dumb", "unknown"):
        yield Finding(
            Severity.WARNING, "terminal", f"TERM={kind} draws no screens: use TERM=xterm-256color"
        )
    else:
        size = shutil.get_terminal_size()
        text = f"{kind}, {size.columns}x{size.lines}"
        small = size.columns < SMALLEST_TERMINAL[0] or size.lines < SMALLEST_TERMINAL[1]
        if small:
            text += f": enlarge it to {SMALLEST_TERMINAL[0]}x{SMALLEST_TERMINAL[1]}"
        yield Finding(Severity.WARNING if small else Severity.OK, "terminal", text)
    encoding = getattr(sys.stdout, "encoding", None) or locale.getpreferredencoding(False)
    if _is_utf8(encoding):
        yield Finding(Severity.OK, "characters", "UTF-8")
    else:
        yield Finding(
            Severity.WARNING, "characters", f"{encoding}: use a UTF-8 locale (LANG=C.UTF-8)"
        )


def _is_utf8(encoding: str) -> bool:
    try:
        return codecs.lookup(encoding).name == "utf-8"
    except LookupError:
        return False


def _safely(subject: str, check: Callable[[], Iterator[Finding]]) -> Iterator[Finding]:
    try:
        yield from check()
    except Exception as error:  # noqa: BLE001  # the doctor must get to the end on a sick machine
        first = next(iter(str(error).splitlines()), "") or type(error).__name__
        yield Finding(Severity.WARNING, subject, f"could not be looked at ({first})")


def look_at_lists(teams: TeamSource, plan: PlanSource, timeout: float = 0.0) -> Iterator[Finding]:
    """A list with a fault has warnings and no other finding; each attempt may take `timeout`, s."""
    listed, planned = teams.read(), plan.read()
    remarks = [*planned.notes, *plan_remarks(planned.lines, listed.names, timeout)]
    for name, problems in (("teams", listed.notes), ("plan", remarks)):
        yield from (Finding(Severity.WARNING, name, problem) for problem in problems)
    if listed.names and not listed.notes:
        yield Finding(Severity.OK, "teams", f"{len(listed.names)} in the list")
    if planned.lines and not remarks:
        attempts = sum(line.attempts for line in planned.lines)
        subjects = {line.task.subject for line in planned.lines}
        conditions = {line.task.condition for line in planned.lines}
        text = f"{attempts} attempts, teams: {len(subjects)}, conditions: {len(conditions)}"
        yield Finding(Severity.OK, "plan", text)


def look_at_state_folder() -> Finding:
    """Check where the engine's lock and log lie."""
    try:
        folder = state_folder()
        if not os.access(folder, os.W_OK):
            raise no_state(folder, OSError(0, "it cannot be written"))
        return Finding(Severity.OK, "state", str(folder))
    except MadrobError as error:
        return Finding(Severity.ERROR, "state", str(error))
