"""Whatever files, names and messages say: one line of words at most, and nothing outside."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from madrob_console.archive import score
from madrob_console.archive.folders import RunName, reserve_run_folder
from madrob_console.archive.history import History
from madrob_console.archive.run_journal import find_unfinished
from madrob_console.archive.scored import open_run
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import clean_name, terminal_safe
from madrob_console.config.settings import example_toml, load_settings
from madrob_console.engine import wire
from madrob_console.engine.client import snapshot_of
from madrob_console.engine.requests import NextRunNumber, OpenRun, Perform
from madrob_console.engine.snapshot import RightToAct
from madrob_console.referee.acts import Abort, SetUp, Waive, act_named
from madrob_console.referee.lists import read_teams
from madrob_console.referee.records import CheckName
from madrob_console.testbeds.simulated import Scenario
from recorder.errors import RecorderError
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
CHANGE = st.tuples(
    st.floats(0, 1),
    st.sampled_from(["insert", "replace", "remove", "repeat", "cut"]),
    st.one_of(st.sampled_from(NASTY), st.binary(max_size=6)),
    st.integers(1, 40),
)


@cache
def recorded() -> Path:
    """A run folder that is never touched; tests take what they need of it."""
    root = TemporaryDirectory()
    _kept.append(root)
    drive = Drive(Path(root.name), Scenario.TOUCH_ONLY)
    drive.start(make_setup(timeout=60.0))
    drive.wait(2.0)
    drive.act(Abort("over"))
    drive.finish()
    drive.engine.close()
    return drive.folder


_kept: list[TemporaryDirectory[str]] = []


def changed(content: bytes, changes: list[tuple[float, str, bytes, int]]) -> bytes:
    for where, how, what, count in changes:
        place = int(where * len(content))
        head, tail = content[:place], content[place:]
        match how:
            case "insert":
                tail = what + tail
            case "replace":
                tail = what + tail[count:]
            case "remove":
                tail = tail[count:]
            case "repeat":
                tail = tail[:count] * 2 + tail[count:]
            case _:
                tail = b""
        content = head + tail
    return content


@dataclass(frozen=True)
class Place:
    """A folder in which everything may go wrong, and a neighbour that nothing may reach."""

    root: Path

    @property
    def inside(self) -> Path:
        return self.root / "inside"

    def copied(self, *patterns: str) -> Path:
        folder = self.inside / recorded().name
        folder.mkdir()
        for pattern in patterns:
            for path in recorded().glob(pattern):
                shutil.copy(path, folder)
        return folder


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    (tmp_path / "outside").write_bytes(b"precious")
    yield Place(tmp_path)
    assert (tmp_path / "outside").read_bytes() == b"precious"
    assert {path.name for path in tmp_path.iterdir()} <= {"outside", "inside"}


def only_words(use: Callable[[], object]) -> None:
    try:
        use()
    except OURS as error:
        words = str(error)
        assert words
        assert words.isprintable()
        assert "please report it" not in words


def in_each(place: Place, examples: int, source: bytes, check: Callable[[bytes], None]) -> None:
    @settings(max_examples=examples, suppress_health_check=list(HealthCheck))
    @given(st.lists(CHANGE, min_size=1, max_size=3))
    def one(changes: list[tuple[float, str, bytes, int]]) -> None:
        shutil.rmtree(place.inside, ignore_errors=True)
        place.inside.mkdir()
        check(changed(source, changes))

    one()


def _csv(place: Place, examples: int) -> None:
    for pattern in ("*_event.csv", "*_jointState.csv", "*_wrench.csv"):
        (file,) = recorded().glob(pattern)

        def check(content: bytes, name: str = file.name) -> None:
            folder = place.copied("*.csv", "*.yaml")
            (folder / "metadata.yaml").unlink()
            (folder / name).write_bytes(content)
            only_words(lambda: list(score(folder)))

        in_each(place, examples // 3 + 1, file.read_bytes(), check)


def _yaml(place: Place, examples: int) -> None:
    for pattern in ("run_info_*.yaml", "condition_*.yaml", "metadata.yaml"):
        (file,) = recorded().glob(pattern)
        rest = ("*.mcap",) if pattern == "metadata.yaml" else ("*.csv",)

        def check(content: bytes, name: str = file.name, rest: tuple[str, ...] = rest) -> None:
            folder = place.copied("run_info*.yaml", "condition*.yaml", *rest)
            (folder / name).write_bytes(content)
            only_words(lambda: list(score(folder)))

        in_each(place, examples // 3 + 1, file.read_bytes(), check)


def _settings(place: Place, examples: int) -> None:
    text = "\n".join(line.removeprefix("# ") for line in example_toml().splitlines())
    for source in (example_toml(), text):

        def check(content: bytes) -> None:
            file = place.inside / "madrob.toml"
            file.write_bytes(content)
            only_words(lambda: load_settings(file))

        in_each(place, examples // 2 + 1, source.encode(), check)


def _socket(place: Place, examples: int) -> None:
    drive = Drive(place.root / "inside" / "results", Scenario.TOUCH_ONLY)
    requests = [
        Perform.of(act)
        for act in (SetUp(make_setup()), Abort("why"), Waive(next(iter(_checks(drive))), "why"))
    ]
    asked = (*requests, OpenRun(recorded().name), NextRunNumber(1, 2))
    messages = [wire.Call(number, 1.0, wire.raw(one)) for number, one in enumerate(asked)]

    def check(content: bytes) -> None:
        for read in (wire.first_of, wire.call_of, wire.message_of):
            only_words(lambda read=read: read(content))  # type: ignore[misc]
        with suppress(MadrobError):
            match wire.call_of(content)[1]:
                case Perform(name, details):
                    only_words(lambda: drive.engine.perform(act_named(name, details)))
                    drive.engine.snapshot()
                case NextRunNumber(subject, condition, practice):
                    only_words(
                        lambda: drive.engine.next_run_number(
                            subject, condition, practice=practice
                        ).result()
                    )
                case _:
                    pass

    for message in messages:
        in_each(place, examples // 5 + 1, msgspec.msgpack.encode(message), check)

    def check_state(content: bytes) -> None:
        with suppress(MadrobError):
            if isinstance(state := wire.message_of(content), wire.State):
                only_words(lambda: snapshot_of(state))

    state = wire.State(wire.raw(drive.engine.snapshot()), wire.raw(RightToAct()))
    in_each(place, examples // 5 + 1, msgspec.msgpack.encode(state), check_state)
    drive.engine.close()


def _checks(drive: Drive) -> list[CheckName]:
    return [check.name for check in drive.engine.situation().checks]


def _team_names(place: Place, examples: int) -> None:
    def check(content: bytes) -> None:
        file = place.inside / "teams.csv"
        file.write_bytes(content)
        only_words(lambda: read_teams(file))
        text = content.decode(errors="surrogateescape")
        assert terminal_safe(text).isprintable()

        def name() -> None:
            name = clean_name(text, "team")
            assert name.isprintable()
            assert len(name) <= 200

        only_words(name)
        with suppress(MadrobError):
            folder = reserve_run_folder(place.inside, RunName(len(content) % 1000, 1, 1), 1.7e9)
            assert folder.parent == place.inside

    in_each(place, examples, b'subject,team\n1,Delft\n2;"Nova, Rot"\n3\tDoor Bots\n', check)


def _run_folder(place: Place, examples: int) -> None:
    names = ("journal.jsonl", "result.json")
    for name in names:

        def check(content: bytes, name: str = name) -> None:
            folder = place.copied("*")
            (folder / name).write_bytes(content)
            History(place.inside).refresh()
            only_words(lambda: find_unfinished(place.inside))
            only_words(lambda: open_run(folder))

        in_each(place, examples // 2 + 1, (recorded() / name).read_bytes(), check)


FAMILIES = {
    "csv": _csv,
    "yaml": _yaml,
    "settings": _settings,
    "socket": _socket,
    "team names": _team_names,
    "run folder": _run_folder,
}


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_no_input_gives_more_than_a_line_of_words(
    place: Place, family: str, request: pytest.FixtureRequest
) -> None:
    """With `--runs 1000` twelve thousand inputs; those of the bag reader have a test of theirs."""
    FAMILIES[family](place, 2 * request.config.getoption("--runs"))
