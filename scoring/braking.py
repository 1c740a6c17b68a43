"""The braking tables with which the testbed makes the door resist (protocol section 3)."""

from __future__ import annotations

from itertools import chain, repeat

from scoring.protocol import GRAM_FORCE, BenchmarkType, Side

_CW_RUNS: dict[BenchmarkType, tuple[tuple[int, int], ...]] = {
    BenchmarkType.NO_FORCE: ((0, 181),),
    BenchmarkType.CONSTANT_FORCE: ((4000, 181),),
    BenchmarkType.SUDDEN_FORCE: ((0, 112), (4000, 69)),
    BenchmarkType.SUDDEN_RAMP: (
        (0, 112),
        (2000, 2),
        (3000, 2),
        (5000, 2),
        (8000, 3),
        (12000, 3),
        (20000, 5),
        (0, 52),
    ),
    BenchmarkType.WIND_RAMP: (
        (0, 7),
        (1000, 11),
        (2000, 15),
        (3000, 20),
        (4000, 77),
        (3000, 20),
        (2000, 15),
        (1000, 11),
        (0, 5),
    ),
}


def braking_table(benchmark_type: BenchmarkType, side: Side) -> tuple[int, ...]:
    """181 braking forces, gram-force, for -90..+90 deg in steps of 1 deg; CCW is CW reversed."""
    runs = _CW_RUNS[benchmark_type]
    table = tuple(chain.from_iterable(repeat(force, degrees) for force, degrees in runs))
    return table if side is Side.CW else table[::-1]


def largest_brake(benchmark_type: BenchmarkType) -> float:
    """The largest force of a braking table, N."""
    return GRAM_FORCE * max(braking_table(benchmark_type, Side.CW))


def door_controller_mode(benchmark_type: BenchmarkType) -> int:
    """0 = brake off, 1 = brake by table."""
    return 0 if benchmark_type is BenchmarkType.NO_FORCE else 1
