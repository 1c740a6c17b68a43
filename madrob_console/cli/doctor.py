"""What `madrob doctor` says: whether this machine can referee, and what stands in the way."""

from __future__ import annotations

import codecs
import locale
import os
import shutil
import sys
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from madrob_console.cli.doctor_ros import Finding, Severity, look_at_ros, overheard
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import counted, format_size, listed
from madrob_console.engine.ipc.engine_lock import no_state, state_folder
from madrob_console.referee.competition_plan import PlanSource, plan_remarks
from madrob_console.referee.evidence_state import EvidenceTopic
from madrob_console.referee.lists import TeamSource
from madrob_console.testbeds.evidence_choice import EvidenceChoice, TopicLimit
from madrob_console.testbeds.ros.evidence_intake import EvidenceIntakes
from madrob_console.testbeds.ros_domain import domain_id

if TYPE_CHECKING:
    from madrob_console.messages.codec import TopicMapping

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
    try:
        import_module("madrob_console.ui.cells.compositor")
    except ImportError as error:
        yield Finding(Severity.WARNING, "textual", str(error))


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


# Findings about the competition's teams and plan.


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


# A finding about the engine's socket.


def look_at_state_folder() -> Finding:
    """Check where the engine's lock and log lie."""
    try:
        folder = state_folder()
        if not os.access(folder, os.W_OK):
            raise no_state(folder, OSError(0, "it cannot be written"))
        return Finding(Severity.OK, "state", str(folder))
    except MadrobError as error:
        return Finding(Severity.ERROR, "state", str(error))


# Findings about the evidence: topics that would be recorded now, and their cost.


LISTENS = 4.0
"""Listening time once a topic is found, s."""

PATIENCE = 10.0
"""Timeout for topics that are not seen yet, s: on a busy machine some take as long."""

_LOOK_PERIOD, _REST = 0.5, 0.02
_HOUR = 3600.0


def look_at_evidence(
    choice: EvidenceChoice,
    own_topics: Collection[str],
    domain: int | None,
    budget: int,
    environment: Mapping[str, str],
    ros_args: Sequence[str] = (),
) -> Iterator[Finding]:
    """Report which topics match now, their rates, and what an hour of recording costs.

    `own_topics` are recorded anyway. `domain` None = as the environment has it. `budget` is in
    bytes. `ros_args` remap names, as a launch file does.
    """
    if not choice.topics:
        yield Finding(Severity.OK, "evidence", "none is wanted: setting `recording.topics`")
        return
    try:
        with overheard() as lines:
            seen = _listen(choice, own_topics, domain, environment, ros_args)
    except MadrobError as error:
        yield Finding(Severity.WARNING, "evidence", str(error))
        return
    topics = seen.topics()
    yield from (_evidence_topic(topic, choice.limit(topic.topic)) for topic in topics)
    if topics:
        yield _whole(topics, budget)
    yield from (Finding(Severity.WARNING, "evidence", words) for words in _missing_evidence(seen))
    yield from (Finding(Severity.WARNING, "ros says", words) for words in lines)


def _listen(
    choice: EvidenceChoice,
    own_topics: Collection[str],
    domain: int | None,
    environment: Mapping[str, str],
    ros_args: Sequence[str],
) -> EvidenceIntakes:
    """Listen for a while; returns what was listened with, closed."""
    intakes = EvidenceIntakes(
        domain_id(domain, environment),
        choice,
        own_topics,
        ros_args=ros_args,
        environment=environment,
        name="doctor_evidence",
    )
    looked, ends, found = 0.0, time.monotonic() + PATIENCE, False
    try:
        while (now := time.monotonic()) < ends:
            if now - looked >= _LOOK_PERIOD:
                looked = now
                intakes.discover(recording=False)
            for _ in intakes.take_messages(time.time_ns):
                pass
            if not found and not intakes.unseen and _comes(intakes.topics()):
                found, ends = True, now + LISTENS
            time.sleep(_REST)
        return intakes
    finally:
        intakes.close()


def _comes(topics: Sequence[EvidenceTopic]) -> bool:
    return not topics or any(topic.rate for topic in topics)


def _missing_evidence(seen: EvidenceIntakes) -> Iterator[str]:
    """What is not there of what is wanted."""
    if seen.unseen:
        within = f"not seen within {PATIENCE:g} s: start what does, or correct the patterns"
        yield f"nobody publishes {', '.join(seen.unseen)}, {within}"
    if seen.left_over:
        too_many = counted(len(seen.left_over), "topic")
        yield f"{too_many} too many, {listed(seen.left_over)}: exclude some"


def _evidence_topic(topic: EvidenceTopic, limit: TopicLimit) -> Finding:
    rate = f"{topic.rate:.1f} Hz, {topic.byte_rate / 1e6:.2f} MB/s"
    if limit.most_rate is not None:
        rate += f" (at most {limit.most_rate:g} Hz by `recording.limits`)"
    lost = f", {topic.lost_count} lost on the way (`madrob guide testbed`)" if topic.lost else ""
    text = f"evidence, {topic.type}, {rate}{lost}"
    problem = topic.problem or ("nothing comes now" if topic.silent else "")
    if problem:
        return Finding(Severity.WARNING, topic.topic, f"{text}: {problem}")
    return Finding(Severity.WARNING if topic.lost else Severity.OK, topic.topic, text)


def _whole(topics: Sequence[EvidenceTopic], budget: int) -> Finding:
    byte_rate = sum(topic.byte_rate for topic in topics)
    hours = (
        f", the budget of {budget / 1e9:g} GB is {budget / byte_rate / _HOUR:.1f} h"
        if byte_rate
        else ""
    )
    text = f"{counted(len(topics), 'topic')}, {byte_rate * _HOUR / 1e9:.2f} GB an hour{hours}"
    return Finding(Severity.OK, "evidence", text)
