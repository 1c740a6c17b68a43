"""The doctor's findings about the evidence: topics that would be recorded, and their cost."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping, Sequence

from madrob_console.cli.doctor_ros import in_child
from madrob_console.cli.finding import Finding, Severity
from madrob_console.common.errors import MadrobError
from madrob_console.common.formatting import counted, listed
from madrob_console.referee.evidence_state import EvidenceTopic
from madrob_console.testbeds.evidence_choice import EvidenceChoice, TopicLimit
from madrob_console.testbeds.ros.evidence_intake import EvidenceIntakes
from madrob_console.testbeds.ros_domain import domain_id

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
    given = choice, tuple(own_topics), domain, budget, dict(environment), ros_args
    yield from in_child("evidence", _look_inside, *given)


def _look_inside(
    choice: EvidenceChoice,
    own_topics: Collection[str],
    domain: int | None,
    budget: int,
    environment: Mapping[str, str],
    ros_args: Sequence[str],
) -> Iterator[Finding]:
    try:
        seen = _listen(choice, own_topics, domain, environment, ros_args)
    except MadrobError as error:
        yield Finding(Severity.WARNING, "evidence", str(error))
        return
    topics = seen.topics()
    yield from (_evidence_topic(topic, choice.limit(topic.topic)) for topic in topics)
    if topics:
        yield _whole(topics, budget)
    yield from (Finding(Severity.WARNING, "evidence", words) for words in _missing_evidence(seen))


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
    """Wanted topics that nobody publishes, and topics beyond the limit."""
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
