"""Reference runs as recordings: samples, by the simulated testbed's encoding, into bags."""

from __future__ import annotations

from collections.abc import Iterator

from mcap.writer import CompressionType, IndexType

from madrob_console.archive.run_record import RECORD_NAME, RunRecord
from madrob_console.common.clock import NS
from madrob_console.common.names import SourceKind
from madrob_console.messages.codec import (
    REFEREE_EVENT_TOPIC,
    describe_topic,
    encode_text,
    referee_topics,
)
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.messages.types import MessageTypes
from madrob_console.referee.acts import SetUp, Start, act_details
from madrob_console.referee.journal import Entry, Origin
from madrob_console.referee.rebuild import Change
from madrob_console.referee.run_setup import RunSetup
from madrob_console.testbeds.simulated.encoder import Encoder
from madrob_console.testbeds.simulated.sensor_model import Reading
from recorder.bag import RawMessage
from scoring.indicator_table import RulesetName
from scoring.protocol import (
    SENSORS_PER_STRIP,
    LockDetection,
    Outcome,
    Signal,
    StartPose,
    Strip,
    Thresholds,
)
from tests.madrob_console.references.runs import COUNTS, PRE_ROLL, ReferenceRun
from tests.recorder.samples import by_library

BEGIN_NS = 1_700_000_000 * NS
"""When every recording begins: a whole second, so that the mean interval is 0.02 s exactly."""

_UNDER_WAY_NS = 1_000_000
_MAPPINGS = tuple(m for m in DEFAULT_MAPPINGS if not m.signal.optional)
_STRIPS = {Signal.of_strip(strip): strip for strip in Strip}
_TYPES = MessageTypes()


def instant_ns(time: float) -> int:
    """Of a time since the start of the run, ns since the epoch."""
    return BEGIN_NS + round((PRE_ROLL + time) * NS)


def record_of(run: ReferenceRun) -> RunRecord:
    """What was set for a run."""
    side = run.condition.starting_side
    setup = RunSetup(
        subject=1,
        team="Reference",
        run_number=1,
        condition=run.condition,
        start_pose=StartPose(1.5 * side.sign, 0.0, 0.0),
        referee="Reference",
        timeout=run.timeout or 60.0,
        countdown=PRE_ROLL,
        ruleset=RulesetName.PROTOCOL,
        lock_detection=LockDetection.SETTLE,
        practice=True,
    )
    return RunRecord(
        setup=setup,
        handle_zero=run.handle_zero,
        thresholds=Thresholds(encoder_counts=COUNTS, encoder_noise=0.0),
        mappings=_MAPPINGS,
        source=SourceKind.SIMULATED,
        competition="",
        version="reference",
    )


def entries(run: ReferenceRun) -> tuple[Entry, ...]:
    """The lines of its journal."""
    begin, start, stop = (instant_ns(t) / NS for t in (-PRE_ROLL, 0.0, run.stop))
    outcome = Outcome.COMPLETED if run.timeout is None else Outcome.TIMEOUT
    why = "all six steps done" if run.timeout is None else "the time is over"
    set_up = SetUp(record_of(run).setup)
    return (
        Entry(begin, Origin.REFEREE, set_up.name, details=act_details(set_up)),
        Entry(begin, Origin.REFEREE, Start.name),
        Entry(start, Origin.CLOCK, Change.RUN_STARTS, details={"time": start}),
        Entry(
            stop,
            Origin.CLOCK,
            Change.RUN_STOPS,
            reason=why,
            details={"outcome": outcome, "time": stop},
        ),
    )


def messages(run: ReferenceRun) -> Iterator[RawMessage]:
    """All messages of a run in the order of its recording."""
    encoders = {mapping: Encoder(mapping, _TYPES) for mapping in _MAPPINGS}
    lines = list(entries(run))
    for time in run.times():
        stamp = instant_ns(time)
        while lines and round(lines[0].time * NS) <= stamp:
            line = lines.pop(0)
            at = round(line.time * NS)
            data = encode_text(_TYPES, line.to_json())
            yield RawMessage(REFEREE_EVENT_TOPIC, "std_msgs/msg/String", data, at, at)
        for mapping, encoder in encoders.items():
            data = encoder.encode(stamp, _reading(run, mapping.signal, time))
            yield RawMessage(mapping.topic, mapping.type, data, stamp, stamp + _UNDER_WAY_NS)


def _reading(run: ReferenceRun, signal: Signal, time: float) -> Reading:
    match signal:
        case Signal.DOOR:
            return run.read_angle(time)
        case Signal.HANDLE:
            return run.read_force(time)
        case _:
            height = run.height(_STRIPS[signal].side, time)
            return (Thresholds().lintel_height - height,) * SENSORS_PER_STRIP


def bag_of(run: ReferenceRun) -> bytes:
    """Its recording without the index of each message; the archive of all compresses it."""
    topics = [describe_topic(_TYPES, m.topic, m.type) for m in _MAPPINGS]
    topics += [topic for topic in referee_topics(_TYPES) if topic.name == REFEREE_EVENT_TOPIC]
    records = {RECORD_NAME: record_of(run).to_metadata()}
    options = {"index_types": IndexType.CHUNK, "compression": CompressionType.NONE}
    return by_library(messages(run), topics, records, **options)
