"""The doctor's look at the evidence: what would be recorded now, and what it would cost."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping, Sequence

from madrob_console.errors import MadrobError
from madrob_console.preparing.finding import Finding, Severity
from madrob_console.preparing.overheard import overheard
from madrob_console.testbeds.evidence_choice import EvidenceChoice, matches
from madrob_console.testbeds.evidence_flow import TopicFlow
from madrob_console.testbeds.ros.evidence_intakes import EvidenceIntakes
from madrob_console.testbeds.ros_domain import domain_id

LISTENS = 4.0
"""So long it listens once it has found something, s."""

_FINDS = 3.0
"""So long it looks for topics, s."""

_LOOK_PERIOD, _REST = 0.5, 0.02
_HOUR = 3600.0

_LARGE = 100_000
"""Mean bytes of messages that are easily lost: Fast DDS hands over 512 kB at once."""


def look_at_evidence(
    choice: EvidenceChoice,
    own_topics: Collection[str],
    domain: int | None,
    budget: int,
    environment: Mapping[str, str],
    ros_args: Sequence[str] = (),
) -> Iterator[Finding]:
    """What matches now, with its rate, and what an hour of it costs.

    Args:
        choice: what is wanted.
        own_topics: those that are recorded anyway.
        domain: ROS domain; None = as the environment has it.
        budget: of evidence, bytes.
        environment: environment variables.
        ros_args: what a launch file says of names.
    """
    if not choice.topics:
        yield Finding(Severity.OK, "evidence", "none is wanted: setting `recording.topics`")
        return
    try:
        with overheard() as lines:
            flows, left_over = _listen(choice, own_topics, domain, environment, ros_args)
    except MadrobError as error:
        yield Finding(Severity.WARNING, "evidence", str(error))
        return
    yield from (_topic(flow) for flow in flows)
    yield _whole(flows, budget)
    there = (*(flow.topic for flow in flows), *left_over)
    idle = [p for p in choice.topics if not any(matches(p, topic) for topic in there)]
    if idle and there:
        text = f"no topic is there for {', '.join(idle)}: start what publishes it, or correct it"
        yield Finding(Severity.WARNING, "evidence", text)
    yield from (Finding(Severity.WARNING, "ros says", words) for words in lines)
    if left_over:
        text = f"{len(left_over)} topics too many, {left_over[0]} and others: exclude some"
        yield Finding(Severity.WARNING, "evidence", text)


def _listen(
    choice: EvidenceChoice,
    own_topics: Collection[str],
    domain: int | None,
    environment: Mapping[str, str],
    ros_args: Sequence[str],
) -> tuple[Sequence[TopicFlow], Sequence[str]]:
    """What comes, and the topics that are too many.

    Raises:
        MadrobError: ROS does not start, or there is no such domain.
    """
    intakes = EvidenceIntakes(
        domain_id(domain, environment),
        choice,
        own_topics,
        ros_args=ros_args,
        environment=environment,
        name="doctor_evidence",
    )
    looked, ends, found = 0.0, time.monotonic() + _FINDS, False
    try:
        while (now := time.monotonic()) < ends:
            if now - looked >= _LOOK_PERIOD:
                looked = now
                intakes.discover(recording=False)
            for _ in intakes.take(time.time_ns):
                pass
            if not found and any(flow.rate for flow in intakes.flows()):
                found, ends = True, now + LISTENS
            intakes.rest(_REST)
        return intakes.flows(), intakes.left_over
    finally:
        intakes.close()


def _topic(flow: TopicFlow) -> Finding:
    rate = f"{flow.rate:.1f} Hz, {flow.byte_rate / 1e6:.2f} MB/s"
    lost = f", {flow.lost} lost on the way" if flow.lost else ""
    text = f"evidence, {flow.type}, {rate}{lost}"
    problem = flow.problem or ("nothing comes now" if flow.silent else "")
    if flow.lost and flow.byte_rate > _LARGE * flow.rate and not problem:
        problem = (
            "have it published reliably, or give its publisher's Fast DDS profile a larger "
            "`segment_size` (README, Cameras)"
        )
    if problem:
        return Finding(Severity.WARNING, flow.topic, f"{text}: {problem}")
    return Finding(Severity.WARNING if flow.lost else Severity.OK, flow.topic, text)


def _whole(flows: Sequence[TopicFlow], budget: int) -> Finding:
    if not flows:
        text = "none of its topics is there: start what publishes them, or correct the patterns"
        return Finding(Severity.WARNING, "evidence", text)
    byte_rate = sum(flow.byte_rate for flow in flows)
    hours = (
        f", the budget of {budget / 1e9:g} GB is {budget / byte_rate / _HOUR:.1f} h"
        if (byte_rate)
        else ""
    )
    text = f"{len(flows)} topics, {byte_rate * _HOUR / 1e9:.2f} GB an hour{hours}"
    return Finding(Severity.OK, "evidence", text)
