"""The slice in virtual time: a run to the digit.

Acts on a slow, a silent and a full disk.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from madrob_console.archive.scored import score_recording
from madrob_console.referee.acts import Abort, AddNote, Start, Void
from madrob_console.referee.journal import read_journal
from madrob_console.referee.rebuild import Change
from madrob_console.referee.run import Phase
from scoring.indicator_table import IndicatorName
from tests.slice.acts import DURABLE_WITHIN
from tests.slice.hall import Hall, play


@asynccontextmanager
async def hall_at(results: Path) -> AsyncIterator[Hall]:
    hall = Hall(results)
    try:
        yield hall
    finally:
        await hall.close()


def test_run_is_scored_as_from_its_bag(tmp_path: Path) -> None:
    async def story() -> None:
        async with hall_at(tmp_path) as hall:
            await hall.run()
            result = hall.engine.current.result
            folder = hall.folder

        assert result is not None
        assert result.indicators[IndicatorName.CAPABILITY_LEVEL].value == 6
        assert result == score_recording(folder)[0].result
        live = [line.details["time"] for line in hall.entries() if line.what == Change.EVENT]
        # The first and the last one are the start and the stop.
        assert live == [event.time for event in result.events[1:-1]]

    play(story())


def test_lines_stand_in_the_order_of_the_acts(tmp_path: Path) -> None:
    async def story() -> None:
        async with hall_at(tmp_path) as hall:
            await hall.run()
            hall.disk.delay = 0.01
            acts = [AddNote(str(number)) for number in range(19)]

            refused = [await hall.act(act) for act in (Void("a dog"), *acts)]

        assert refused == [None] * 20
        assert [line.reason for line in hall.entries()[-20:]] == ["a dog", *map(str, range(19))]

    play(story())


def test_start_is_withdrawn_when_the_disk_hangs(tmp_path: Path) -> None:
    async def story() -> None:
        async with hall_at(tmp_path) as hall:
            await hall.make_ready(60.0)
            hall.disk.delay = 10.0
            asked = hall.engine.current.now()

            refusal = await hall.act(Start())
            waited = hall.engine.current.now() - asked
            await asyncio.sleep(30.0)
            phase = hall.engine.current.run.phase

        assert refusal == "the disk did not take it within 2 s: it is withdrawn"
        assert waited == DURABLE_WITHIN
        assert phase is Phase.READY

    play(story())
    (journal,) = tmp_path.rglob("journal.jsonl")
    stands = [line.what for line in read_journal(journal)[0]]
    assert "start" not in stands
    assert stands[-1] == "withdrawn"


def test_start_is_refused_when_the_disk_refuses(tmp_path: Path) -> None:
    async def story() -> None:
        async with hall_at(tmp_path) as hall:
            await hall.make_ready(60.0)
            hall.disk.refusals = 1

            refusal = await hall.act(Start())
            again = await hall.act(Start())

        assert refusal == "No space left on device: see to the disk, then try again"
        assert again is None

    play(story())


def test_abort_takes_back_a_start_that_waits(tmp_path: Path) -> None:
    async def story() -> None:
        async with hall_at(tmp_path) as hall:
            await hall.make_ready(60.0)
            hall.disk.delay = 1.0
            start = asyncio.create_task(hall.act(Start()))
            await asyncio.sleep(0.5)

            aborted = await hall.act(Abort("a child"))

            assert aborted is None
            assert await start == "taken back by the referee: it is withdrawn"
            assert hall.engine.current.run.phase is Phase.READY

    play(story())


def test_abort_takes_effect_while_the_disk_hangs(tmp_path: Path) -> None:
    async def story() -> None:
        async with hall_at(tmp_path) as hall:
            await hall.make_ready(60.0)
            assert await hall.act(Start()) is None
            await asyncio.sleep(3.0)
            hall.disk.delay = 30.0
            asked = hall.engine.current.now()

            refusal = await hall.act(Abort("a child"))
            waited = hall.engine.current.now() - asked
            phase = hall.engine.current.run.phase

        assert refusal is None
        assert waited == 0.0
        assert phase is Phase.STOPPED
        assert "abort" in hall.lines()

    play(story())


def test_same_act_is_performed_once(tmp_path: Path) -> None:
    async def story() -> None:
        async with hall_at(tmp_path) as hall:
            await hall.make_ready(60.0)
            acts = hall.engine.acts

            refusals = [await acts.perform(AddNote("once"), "its id") for _ in range(2)]

            assert refusals == [None, None]
            assert [note.text for note in hall.engine.current.run.notes] == ["once"]

    play(story())
