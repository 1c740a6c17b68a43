"""A copy of a recording that has a file with it."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer

from recorder.attachments import FileEnding, attach, detach, read_attachment
from recorder.reader import Bag
from recorder.writer import BagWriter
from tests.recorder.samples import (
    by_library,
    door_messages,
    door_topics,
)

NAME = "result.json"


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bag") / "run"
    with BagWriter(folder, door_topics(), {"run": {"subject": "7"}}) as writer:
        writer.put_all(door_messages(20))
    return folder / "run_0.mcap"


def ending_with(stored: bytes, ending: FileEnding | None) -> bytes:
    assert ending is not None
    return stored[: ending.begin] + ending.data


@given(data=st.binary(max_size=3000))
def test_a_copy_with_an_attachment_reads_everywhere_and_gives_the_file_back(
    bag: Path, data: bytes
) -> None:
    stored = bag.read_bytes()
    copy = ending_with(stored, attach(BytesIO(stored), NAME, "application/json", data))
    reader = make_reader(BytesIO(copy), validate_crcs=True)
    assert [(each.name, each.data) for each in reader.iter_attachments()] == [(NAME, data)]
    assert sum(1 for _ in reader.iter_messages()) == 20 * len(door_topics())
    assert read_attachment(BytesIO(copy), NAME) == data
    assert attach(BytesIO(copy), NAME, "", b"another one") is None
    assert ending_with(copy, detach(BytesIO(copy), NAME)) == stored


def test_our_reader_takes_the_copy_as_it_takes_the_file(bag: Path, tmp_path: Path) -> None:
    stored = bag.read_bytes()
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(ending_with(stored, attach(BytesIO(stored), NAME, "text/plain", b"7")))
    assert list(Bag(copy).messages()) == list(Bag(bag).messages())


@given(cut=st.integers(0, 2**20), flipped=st.integers(0, 2**20))
def test_a_torn_file_has_no_attachment_and_gets_none(bag: Path, cut: int, flipped: int) -> None:
    stored = bag.read_bytes()
    copy = ending_with(stored, attach(BytesIO(stored), NAME, "", b"data"))
    torn = BytesIO(copy[: cut % len(copy)])
    found = {read_attachment(torn, NAME), detach(torn, NAME), attach(torn, NAME, "", b"")}
    assert found == {None}
    changed = bytearray(copy)
    changed[flipped % len(copy)] ^= 0x55
    for read in (read_attachment, detach):
        read(BytesIO(changed), NAME)  # raises nothing


def test_what_cannot_be_given_back_to_the_last_byte_gets_no_attachment() -> None:
    messages = door_messages(1)
    without = BytesIO(by_library(messages, door_topics(), use_statistics=False))
    assert attach(without, NAME, "", b"data") is None
    assert detach(without, NAME) is None
    file = BytesIO()
    writer = Writer(file)
    writer.start(profile="ros2")
    writer.add_attachment(0, 0, NAME, "", b"data")
    writer.add_metadata("behind", {"it": "lies more"})
    writer.finish()  # type: ignore[no-untyped-call]
    assert read_attachment(file, NAME) == b"data"
    assert read_attachment(file, "another") is None
    assert detach(file, NAME) is None
