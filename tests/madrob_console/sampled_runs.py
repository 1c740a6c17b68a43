"""Simulated runs as samples: one motion, read with any phase, noise, network and fault."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from random import Random

from madrob_console.testbeds.simulated.geometry import DoorGeometry
from madrob_console.testbeds.simulated.motion import MotionPlan
from madrob_console.testbeds.simulated.sensor_model import (
    Reading,
    Scene,
    SensorModel,
    SensorSettings,
)
from scoring.assessment import Assessment
from scoring.indicator_table import RulesetName
from scoring.protocol import Condition, LockDetection, Outcome, Signal, Strip, Thresholds
from scoring.result import Ending, Result
from scoring.rows import Rows
from scoring.samples import DoorSample, HandleSample, PassageSample, Sample
from tests.madrob_console.robots import Played, plan_run

START = 1_700_000_000.0
PRE_ROLL, POST_ROLL, ZEROED = 4.0, 6.0, 2.5  # s; the handle is zeroed until so long before
STRIPS = tuple(Signal.of_strip(strip) for strip in Strip)
EXACT = replace(SensorSettings(), jitter=0.0, handle_noise=0.0, range_noise=0.0)
EXACT_ANGLE = Thresholds(encoder_counts=10**8, encoder_noise=0.0)


@dataclass(frozen=True)
class Network:
    """How late messages arrive, by signal, s: always, and at random (half-normal)."""

    latency: Mapping[Signal, float] = field(default_factory=dict)
    jitter: Mapping[Signal, float] = field(default_factory=dict)


@cache
def plan_of(scenario: Played, condition: int = 6, seed: int = 1) -> MotionPlan:
    return plan_run(scenario, Condition.from_number(condition), DoorGeometry(), Random(f"{seed}"))


def sampled(
    plan: MotionPlan,
    seed: int,
    settings: SensorSettings | None = None,
    *,
    encoder: Thresholds | None = None,
    network: Network | None = None,
) -> list[Sample]:
    """All samples of a run in the order in which they arrive."""
    settings, network = settings or SensorSettings(), network or Network()
    model = SensorModel(DoorGeometry(thresholds=encoder or Thresholds()), settings, seed)
    signals = [signal for signal in Signal if not signal.optional]
    samples = [s for signal in signals for s in _of_signal(plan, model, signal, seed, network)]
    return sorted(samples, key=lambda sample: sample.log_time)


def _of_signal(
    plan: MotionPlan, model: SensorModel, signal: Signal, seed: int, network: Network
) -> Iterator[Sample]:
    timing, late = (Random(f"{seed}/{what}/{signal.name}") for what in ("timing", "network"))
    period = 1 / model.settings.rate
    nominal, arrived = timing.random() * period - PRE_ROLL, -math.inf
    while nominal < plan.end + POST_ROLL:
        stray = timing.gauss(0.0, model.settings.jitter)
        time = nominal + max(-period / 5, min(period / 5, stray))
        scene = Scene.of(plan, time)
        way = 0.0003 + network.latency.get(signal, 0.0) + min(0.003, timing.expovariate(5000))
        way += abs(late.gauss(0.0, network.jitter.get(signal, 0.0)))
        arrived = max(time + way, arrived + 1e-9)  # no message overtakes another
        yield _sample(signal, START + time, START + arrived, model.read(signal, scene))
        nominal += period


def _sample(signal: Signal, time: float, log_time: float, reading: Reading) -> Sample:
    match reading:
        case tuple():
            strip = next(strip for strip in Strip if Signal.of_strip(strip) is signal)
            return PassageSample(time, log_time, strip, reading, 0.02, 4.0)
        case _ if signal is Signal.DOOR:
            return DoorSample(time, log_time, float(reading))
        case _:
            return HandleSample(time, log_time, float(reading))


def zero_of(samples: list[Sample]) -> float:
    """The handle's mean before the countdown, N."""
    rest = [s.force for s in samples if isinstance(s, HandleSample) and s.time < START - ZEROED]
    return sum(rest) / len(rest)


def scored(
    samples: list[Sample],
    plan: MotionPlan,
    rules: RulesetName = RulesetName.PROTOCOL,
    zero: float | None = None,
) -> tuple[Result, Rows]:
    """The result of a run that stops by itself, or 4 s after all has come to rest."""
    run = Assessment(
        plan.condition,
        START,
        ruleset=rules,
        lock_detection=LockDetection.SETTLE,
        handle_zero=zero_of(samples) if zero is None else zero,
    )
    for sample in samples:
        run.feed(sample)
    run.release(math.inf)
    done, limit = run.procedure().completed, START + plan.end + 4.0
    if done is not None and done <= limit:
        return run.result(Ending(Outcome.COMPLETED, "all six steps done", done))
    return run.result(Ending(Outcome.TIMEOUT, "time over", limit))
