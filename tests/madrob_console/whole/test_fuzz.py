"""Whatever files, names and messages say: one line of words at most, and nothing outside."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from madrob_console.archive import score
from madrob_console.archive.history import History
from madrob_console.archive.scored import open_run
from madrob_console.archive.unfinished_runs import find_unfinished
from madrob_console.common.errors import MadrobError
from madrob_console.config.settings import load_settings
from madrob_console.config.settings_example import example_toml
from madrob_console.engine.ipc import wire
from madrob_console.engine.ipc.client import snapshot_of
from madrob_console.engine.requests import NextRunNumber, OpenRun, Perform
from madrob_console.engine.snapshot import RightToAct
from madrob_console.referee.acts import Abort, SetUp, Waive, act_named
from madrob_console.referee.records import CheckName
from madrob_console.testbeds.simulated import Scenario
from recorder import RecorderError
from scoring.protocol import ScoringError
from tests.madrob_console.engine.drive import Drive, make_setup

OURS = (MadrobError, ScoringError, RecorderError)
NASTY = (
    b"", b"\0", b"\n", b"\r\n", b'"', b"'", b",", b";", b"\t", b"-", b"[" * 3000, b"{" * 3000,
    b"[[", b"]]", b"= ", b"\xff\xfe", b"\x1b]0;x\x07", b"\x1b[2J", "\u202e".encode(), b"nan",
    b"NaN", b"-inf", b"1e999", b"9" * 400, b"0x", b"true", b"null", b"TIMEOUT", b"../", b"/etc",
    b"!!python/object/apply:os.system ['touch outside']", b"&a [*a]", b"!!timestamp x",
    b"$(touch outside)", b"`touch outside`", b"%s%n", b"{0.__class__}", b"\\N{BULLET}", b"\\x",
)  # fmt: skip
Change = tuple[float, int, int, bytes]
"""Where, of the whole; how many bytes go; how often the next 20 are repeated; what is put in."""
CHANGES = st.lists(
    st.tuples(
        st.floats(0, 1),
        st.sampled_from([0, 0, 1, 40, 1 << 30]),
        st.sampled_from([0, 0, 2]),
        st.one_of(st.sampled_from(NASTY), st.binary(max_size=6)),
    ),
    min_size=1,
    max_size=3,
)
_kept: list[TemporaryDirectory[str]] = []


@cache
def recorded() -> Path:
    """A run folder that is never touched; tests take what they need of it."""
    _kept.append(TemporaryDirectory())
    drive = Drive(Path(_kept[-1].name), Scenario.TOUCH_ONLY)
    drive.start(make_setup(timeout=60.0))
    drive.wait(2.0)
    drive.act(Abort("over"))
    drive.finish()
    drive.engine.close()
    return drive.folder


def changed(content: bytes, changes: list[Change]) -> bytes:
    for where, gone, repeated, what in changes:
        place = int(where * len(content))
        tail = content[place:][:20] * repeated + content[place:]
        content = content[:place] + what + tail[gone:]
    return content


def only_words(use: Callable[[], object]) -> None:
    try:
        use()
    except OURS as error:
        words = str(error)
        assert words
        assert words.isprintable()
        assert "please report it" not in words


Check = Callable[[bytes], None]
"""Reads what was changed."""


def copied(folder: Path, name: str, content: bytes, *patterns: str) -> Path:
    """A run folder with files of the recorded one, one of them changed."""
    run = folder / recorded().name
    run.mkdir()
    for pattern in patterns:
        for path in recorded().glob(pattern):
            shutil.copy(path, run)
    (run / name).write_bytes(content)
    return run


def files_of_a_run(folder: Path) -> Iterator[tuple[bytes, Check]]:
    tables = ("run_info*.yaml", "condition*.yaml", "*.csv")
    for pattern in ("*_event.csv", "*_jointState.csv", "*_wrench.csv", *tables[:2]):
        (file,) = recorded().glob(pattern)

        def check(content: bytes, name: str = file.name) -> None:
            run = copied(folder, name, content, *tables)
            only_words(lambda: list(score(run)))

        yield file.read_bytes(), check

    def check_bag(content: bytes) -> None:
        run = copied(folder, "metadata.yaml", content, *tables[:2], "*.mcap")
        only_words(lambda: list(score(run)))

    yield (recorded() / "metadata.yaml").read_bytes(), check_bag


def run_folders(folder: Path) -> Iterator[tuple[bytes, Check]]:
    for name in ("journal.jsonl", "result.json"):

        def check(content: bytes, name: str = name) -> None:
            run = copied(folder, name, content, "*")
            History(folder).refresh()
            only_words(lambda: find_unfinished(folder))
            only_words(lambda: open_run(run))

        yield (recorded() / name).read_bytes(), check


def settings_files(folder: Path) -> Iterator[tuple[bytes, Check]]:
    def check(content: bytes) -> None:
        file = folder / "madrob.toml"
        file.write_bytes(content)
        only_words(lambda: load_settings(file))

    yield example_toml().encode(), check
    text = "\n".join(line.removeprefix("# ") for line in example_toml().splitlines())
    yield text.encode(), check


def socket_messages(folder: Path) -> Iterator[tuple[bytes, Check]]:
    drive = Drive(folder / "results", Scenario.TOUCH_ONLY)

    def check(content: bytes) -> None:
        for read in (wire.first_of, wire.call_of, wire.message_of):
            only_words(lambda read=read: read(content))  # type: ignore[misc]
        with suppress(MadrobError):
            match wire.call_of(content)[1]:
                case Perform(name, details):
                    only_words(lambda: drive.engine.perform(act_named(name, details)))
                    drive.engine.snapshot()
                case NextRunNumber(subject, condition, practice):
                    asked = drive.engine.next_run_number(subject, condition, practice=practice)
                    only_words(asked.result)

    acts = SetUp(make_setup()), Abort("why"), Waive(CheckName.TOPICS, "why")
    asked = (*map(Perform.of, acts), OpenRun(recorded().name), NextRunNumber(1, 2))
    for number, one in enumerate(asked):
        yield msgspec.msgpack.encode(wire.Call(number, 1.0, wire.raw(one))), check

    def check_state(content: bytes) -> None:
        with suppress(MadrobError):
            if isinstance(state := wire.message_of(content), wire.State):
                only_words(lambda: snapshot_of(state))

    state = wire.State(wire.raw(drive.engine.snapshot()), wire.raw(RightToAct()))
    yield msgspec.msgpack.encode(state), check_state
    drive.engine.close()


@pytest.mark.slow
@pytest.mark.parametrize("family", [files_of_a_run, run_folders, settings_files, socket_messages])
def test_no_input_gives_more_than_a_line_of_words(
    family: Callable[[Path], Iterator[tuple[bytes, Check]]],
    tmp_path: Path,
    request: pytest.FixtureRequest,
) -> None:
    """With `--runs 1000` eight thousand inputs; bags, teams and names have tests of their own."""
    inside, outside = tmp_path / "inside", tmp_path / "outside"
    outside.write_bytes(b"precious")
    inside.mkdir()
    for source, check in family(inside):

        @settings(
            max_examples=max(2, request.config.getoption("--runs") // 2),
            suppress_health_check=list(HealthCheck),
        )
        @given(changes=CHANGES)
        def one(changes: list[Change]) -> None:
            for path in inside.glob("*"):
                shutil.rmtree(path) if path.is_dir() else path.unlink()
            check(changed(source, changes))  # noqa: B023

        one()
    assert outside.read_bytes() == b"precious"
    assert {path.name for path in tmp_path.iterdir()} == {"outside", "inside"}
