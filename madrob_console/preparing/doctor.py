"""What `madrob doctor` says: whether this machine can referee, and what stands in the way."""

from __future__ import annotations

import codecs
import locale
import os
import shutil
import sys
import tomllib
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.preparing.finding import Finding, Severity
from madrob_console.referee.amounts import size_words
from madrob_console.version import DISTRIBUTION

if TYPE_CHECKING:
    from madrob_console.kinds import RemoteService
    from madrob_console.messages.codec import TopicMapping

OLDEST_PYTHON = (3, 11)
SMALLEST_TERMINAL = (80, 24)
SUBJECT_WIDTH = len("/madrob/passage/ccw_right")


def doctor(  # noqa: PLR0913  what it looks at
    mappings: Sequence[TopicMapping],
    results: Path,
    *,
    domain: int | None = None,
    disk_space: int,
    listen: float = 2.0,
    environment: Mapping[str, str] = os.environ,
    services: Collection[RemoteService] = (),
    lists: Callable[[], Iterator[Finding]] = lambda: iter(()),
    evidence: Callable[[], Iterator[Finding]] = lambda: iter(()),
) -> Iterator[Finding]:
    """Look at everything the console needs, one after the other; never raises.

    Args:
        mappings: the configured topics.
        results: the folder in which runs are kept.
        domain: ROS domain; None = `ROS_DOMAIN_ID`, or 0.
        disk_space: bytes that should be free.
        listen: how long to listen to the testbed, s, once it is found; 0 = not. Looking for it
            takes 3 s at most.
        environment: environment variables.
        services: what other programs of the ROS domain may call.
        lists: looks at the competition's lists.
        evidence: looks at what would be recorded beside the testbed's topics.
    """

    def testbed() -> Iterator[Finding]:
        from madrob_console.preparing.doctor_ros import look_at_ros

        return look_at_ros(mappings, domain, listen, environment, services)

    def session() -> Iterator[Finding]:
        from madrob_console.preparing.doctor_session import look_at_session

        return look_at_session(environment)

    checks: tuple[tuple[str, Callable[[], Iterator[Finding]]], ...] = (
        ("python", look_at_python),
        ("packages", lambda: look_at_packages(_requirements())),
        ("results", lambda: look_at_results(results, disk_space)),
        ("lists", lists),
        ("terminal", lambda: look_at_terminal(environment)),
        ("log-out", session),
        ("ros", testbed),
        ("evidence", evidence),
    )
    for subject, check in checks:
        yield from _safely(subject, check)


def usable(findings: Sequence[Finding]) -> bool:
    """Whether the console runs here."""
    return all(finding.severity is not Severity.ERROR for finding in findings)


def line(finding: Finding) -> str:
    """A finding as a line of plain text."""
    return f"{finding.severity.name.lower():7}  {finding.subject:{SUBJECT_WIDTH}}  {finding.text}"


def verdict(findings: Sequence[Finding]) -> str:
    """What all findings come to, as a line."""
    if not usable(findings):
        return "not usable: see the errors above"
    warnings = sum(finding.severity is Severity.WARNING for finding in findings)
    return f"usable, {warnings} warning{'s' if warnings > 1 else ''}" if warnings else "usable"


def look_at_python() -> Iterator[Finding]:
    """Python itself."""
    version = ".".join(map(str, sys.version_info[:3]))
    if sys.version_info[:2] < OLDEST_PYTHON:
        needed = ".".join(map(str, OLDEST_PYTHON))
        yield Finding(Severity.ERROR, "python", f"{version}: install {needed} or newer")
    else:
        yield Finding(Severity.OK, "python", f"{version}, {sys.prefix}")


def look_at_packages(requirements: Sequence[str] | None) -> Iterator[Finding]:
    """The libraries without which the console does not run.

    Args:
        requirements: as pyproject.toml has them (PEP 508), extras and all; None = nobody knows.
    """
    if requirements is None:
        unknown = f"nothing says which are needed: install {DISTRIBUTION} to have them looked at"
        yield Finding(Severity.WARNING, "packages", unknown)
        return
    try:
        from packaging.requirements import Requirement
    except ModuleNotFoundError:
        yield _missing("packaging")
        return
    found = []
    for requirement in map(Requirement, requirements):
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": ""}):
            continue  # of another platform, or of an extra
        try:
            found.append(f"{requirement.name} {metadata.version(requirement.name)}")
        except metadata.PackageNotFoundError:
            yield _missing(requirement.name)
    yield Finding(Severity.OK, "packages", ", ".join(found))


def _missing(package: str) -> Finding:
    text = f"{package} is missing: install {DISTRIBUTION} again"
    return Finding(Severity.ERROR, "packages", text)


def _requirements() -> Sequence[str] | None:
    """What this installation needs, or this source tree that is not installed."""
    try:
        return metadata.requires(DISTRIBUTION)
    except metadata.PackageNotFoundError:
        pass
    try:
        project = (Path(__file__).parents[2] / "pyproject.toml").read_bytes().decode()
    except OSError:
        return None
    dependencies: list[str] = tomllib.loads(project)["project"]["dependencies"]
    return dependencies


def look_at_results(folder: Path, disk_space: int) -> Iterator[Finding]:
    """The results folder: whether it can be written, and how much fits."""
    place = next((place for place in (folder, *folder.parents) if place.exists()), folder)
    if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
        yield Finding(
            Severity.ERROR, "results", f"{folder} cannot be written: set results.folder to another"
        )
        return
    free = shutil.disk_usage(place).free
    text = f"{folder}: {size_words(free)} free"
    if free < disk_space:
        needed = size_words(disk_space)
        yield Finding(Severity.WARNING, "results", f"{text}, less than {needed}: make room")
    else:
        yield Finding(Severity.OK, "results", text)


def look_at_terminal(environment: Mapping[str, str]) -> Iterator[Finding]:
    """The terminal: kind, colours, size, characters."""
    kind = environment.get("TERM", "")
    if not sys.stdout.isatty():
        yield Finding(Severity.OK, "terminal", "none: the output goes elsewhere")
    elif kind in ("", "dumb", "unknown"):
        yield Finding(
            Severity.WARNING, "terminal", f"TERM={kind} draws no screens: use TERM=xterm-256color"
        )
    else:
        size = shutil.get_terminal_size()
        text = f"{kind}, {_colours(kind, environment)}, {size.columns}x{size.lines}"
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


def _colours(kind: str, environment: Mapping[str, str]) -> str:
    if environment.get("NO_COLOR"):
        return "no colours (NO_COLOR)"
    if environment.get("COLORTERM", "") in ("truecolor", "24bit"):
        return "16 million colours"
    return "256 colours" if "256" in kind else "16 colours"


def _is_utf8(encoding: str) -> bool:
    try:
        return codecs.lookup(encoding).name == "utf-8"
    except LookupError:
        return False


def _safely(subject: str, check: Callable[[], Iterator[Finding]]) -> list[Finding]:
    findings: list[Finding] = []
    try:
        findings.extend(check())
    except Exception as error:  # noqa: BLE001  # the doctor must get to the end on a sick machine
        first = next(iter(str(error).splitlines()), "") or type(error).__name__
        findings.append(Finding(Severity.WARNING, subject, f"could not be looked at ({first})"))
    return findings
