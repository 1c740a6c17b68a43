"""The doctor's findings about the topics that are recorded beside the run."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

from madrob_console.cli.doctor_ros import in_child
from madrob_console.cli.finding import Finding, Severity
from madrob_console.common.errors import MadrobError
from madrob_console.testbeds.ros.evidence_topics import EvidenceTopics
from madrob_console.testbeds.ros_domain import domain_id

PATIENCE = 10.0
"""Time for all topics to be heard, s."""

LISTENS = 4.0
"""Listening time once all are heard, s."""

_PERIOD = 0.02


def look_at_evidence(
    topics: Sequence[str], domain: int | None, environment: Mapping[str, str]
) -> Iterator[Finding]:
    """Report for each topic of the settings whether it is heard, its type and its MB a minute.

    `domain` None = as the environment has it.
    """
    if not topics:
        yield Finding(Severity.OK, "evidence", "none is wanted: setting `evidence.topics`")
        return
    yield from in_child("evidence", _listen, tuple(topics), domain, dict(environment))


def _listen(
    names: Sequence[str], domain: int | None, environment: Mapping[str, str]
) -> Iterator[Finding]:
    sizes: Counter[str] = Counter()
    ends = time.monotonic() + PATIENCE
    first = time.monotonic()
    try:
        with EvidenceTopics(domain_id(domain, environment), names) as listened:
            while time.monotonic() < ends:
                for message in listened.take_messages(time.time_ns()):
                    if not sizes:
                        first = time.monotonic()
                    if message.topic not in sizes:
                        ends = min(ends, time.monotonic() + LISTENS)
                    sizes[message.topic] += len(message.data)
                time.sleep(_PERIOD)
            types = {topic.name: topic.type for topic in listened.topics}
            problems = listened.problems
    except MadrobError as error:
        yield Finding(Severity.WARNING, "evidence", str(error))
        return
    minutes = (time.monotonic() - first) / 60
    for name in names:
        kind = types.get(name, "evidence")
        if name not in sizes:
            why = problems.get(name, f"not heard within {PATIENCE:g} s: start what publishes it")
            yield Finding(Severity.WARNING, name, f"{kind}: {why}")
            continue
        yield Finding(Severity.OK, name, f"{kind}, {sizes[name] / 1e6 / minutes:.1f} MB a minute")
