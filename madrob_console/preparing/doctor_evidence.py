"""The doctor's look at the evidence: what would be recorded now, and what it would cost."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from madrob_console.errors import MadrobError
from madrob_console.preparing.finding import Finding, Severity
from madrob_console.preparing.overheard import overheard
from madrob_console.referee.amounts import counted, listed
from madrob_console.testbeds.evidence_choice import EvidenceChoice, TopicLimit
from madrob_console.testbeds.evidence_flow import TopicFlow
from madrob_console.testbeds.ros.evidence_intakes import EvidenceIntakes
from madrob_console.testbeds.ros_domain import domain_id

LISTENS = 4.0
"""So long it listens once it has found something, s."""

PATIENCE = 10.0
"""So long it looks for topics that are not seen yet, s: on a busy machine some take as long."""

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
            seen = _listen(choice, own_topics, domain, environment, ros_args)
    except MadrobError as error:
        yield Finding(Severity.WARNING, "evidence", str(error))
        return
    yield from (_topic(flow, choice.limit(flow.topic)) for flow in seen.flows)
    if seen.flows:
        yield _whole(seen.flows, budget)
    yield from (Finding(Severity.WARNING, "evidence", words) for words in _missing(seen))
    yield from (Finding(Severity.WARNING, "ros says", words) for words in lines)


@dataclass(frozen=True, slots=True)
class _Seen:
    """What was seen.

    Attributes:
        flows: what comes.
        left_over, unseen, scored: see `EvidenceIntakes`.
    """

    flows: Sequence[TopicFlow]
    left_over: Sequence[str]
    unseen: Sequence[str]
    scored: Sequence[str]


def _listen(
    choice: EvidenceChoice,
    own_topics: Collection[str],
    domain: int | None,
    environment: Mapping[str, str],
    ros_args: Sequence[str],
) -> _Seen:
    """What comes: it listens for a while once there is something for each pattern.

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
    looked, ends, found = 0.0, time.monotonic() + PATIENCE, False
    try:
        while (now := time.monotonic()) < ends:
            if now - looked >= _LOOK_PERIOD:
                looked = now
                intakes.discover(recording=False)
            for _ in intakes.take(time.time_ns):
                pass
            if not found and not intakes.unseen and _comes(intakes.flows()):
                found, ends = True, now + LISTENS
            intakes.rest(_REST)
        return _Seen(intakes.flows(), intakes.left_over, intakes.unseen, intakes.scored)
    finally:
        intakes.close()


def _comes(flows: Sequence[TopicFlow]) -> bool:
    """Whether something comes, or there is nothing that could."""
    return not flows or any(flow.rate for flow in flows)


def _missing(seen: _Seen) -> Iterator[str]:
    """What is not there of what is wanted, or needs not be asked for."""
    if seen.unseen:
        within = f"not seen within {PATIENCE:g} s: start what does, or correct the patterns"
        yield f"nobody publishes {', '.join(seen.unseen)}, {within}"
    if seen.scored:
        yield f"{', '.join(seen.scored)}: recorded with the score, remove the pattern"
    if seen.left_over:
        too_many = counted(len(seen.left_over), "topic")
        yield f"{too_many} too many, {listed(seen.left_over)}: exclude some"


def _topic(flow: TopicFlow, limit: TopicLimit) -> Finding:
    rate = f"{flow.rate:.1f} Hz, {flow.byte_rate / 1e6:.2f} MB/s"
    if limit.most_rate is not None:
        rate += f" (at most {limit.most_rate:g} Hz by `recording.limits`)"
    lost = f", {flow.lost} lost on the way" if flow.lost else ""
    text = f"evidence, {flow.type}, {rate}{lost}"
    problem = flow.problem or ("nothing comes now" if flow.silent else "")
    if flow.lost and flow.byte_rate > _LARGE * flow.rate and not problem:
        problem = (
            "have it published reliably, or give its publisher's Fast DDS profile a larger "
            "`segment_size` (`madrob guide testbed`)"
        )
    if problem:
        return Finding(Severity.WARNING, flow.topic, f"{text}: {problem}")
    return Finding(Severity.WARNING if flow.lost else Severity.OK, flow.topic, text)


def _whole(flows: Sequence[TopicFlow], budget: int) -> Finding:
    byte_rate = sum(flow.byte_rate for flow in flows)
    hours = (
        f", the budget of {budget / 1e9:g} GB is {budget / byte_rate / _HOUR:.1f} h"
        if byte_rate
        else ""
    )
    text = f"{counted(len(flows), 'topic')}, {byte_rate * _HOUR / 1e9:.2f} GB an hour{hours}"
    return Finding(Severity.OK, "evidence", text)
