"""Shards: every run is in exactly one, whoever asks and whenever."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.shards import Shard, shared_out
from madrob_console.errors import MadrobError


def runs(names: list[str], below: str = "/data") -> list[RunPath]:
    return [RunPath(Path(below) / name) for name in names]


def named(number: int) -> str:
    return f"subject_001_cond_001_run_{number:03d}_20260501_120000"


@given(st.lists(st.text("abc_019", min_size=1, max_size=8), unique=True), st.integers(1, 9))
def test_all_shards_together_have_every_run_once_and_in_its_order(
    names: list[str], count: int
) -> None:
    every = runs(names)
    shards = [shared_out(every, Shard(number, count)) for number in range(1, count + 1)]
    assert Counter(run for shard in shards for run in shard) == Counter(every)
    assert all(shard == sorted(shard, key=every.index) for shard in shards)
    assert shared_out(every, None) == every


def test_a_run_s_shard_hangs_neither_on_where_it_lies_nor_on_the_runs_beside_it() -> None:
    names = [named(number) for number in range(60)]
    here = {run.path.name for run in shared_out(runs(names), Shard(2, 5))}
    there = shared_out(runs(names[::-1], "/mnt/cluster/archive"), Shard(2, 5))
    assert {run.path.name for run in there} == here
    fewer = shared_out(runs(names[:30]), Shard(2, 5))
    assert {run.path.name for run in fewer} == here & set(names[:30])


def test_shards_are_about_equally_large() -> None:
    every = runs([named(number) for number in range(999)])
    sizes = [len(shared_out(every, Shard(number, 4))) for number in range(1, 5)]
    assert min(sizes) > 200
    assert max(sizes) < 300


@pytest.mark.parametrize(
    "text", ["", "3", "0/4", "5/4", "-1/4", "1/0", "1/4/2", "a/b", "1 /4", "٣/4"]
)
def test_what_is_no_shard_is_refused(text: str) -> None:
    with pytest.raises(MadrobError, match="give i/n, from 1/n to n/n"):
        Shard.parse(text)


def test_a_shard_reads_as_it_is_written() -> None:
    assert str(Shard.parse("2/8")) == "2/8"
    assert Shard.parse("2/8").folder_name == "shard_2_of_8"
