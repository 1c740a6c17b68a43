"""The pictures of a run, in a folder of their own and in its report."""

from __future__ import annotations

import io
import re
import shutil
import struct
import sys
import zlib
from dataclasses import replace
from functools import cache
from itertools import count
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from madrob_console.archive.check import check_run
from madrob_console.archive.folders import PICTURES_FOLDER, PICTURES_INDEX
from madrob_console.archive.nearest_frames import SIDE
from madrob_console.archive.picture import (
    MOST_BYTES,
    MOST_MESSAGE,
    PictureError,
    decoded,
    jpeg,
    opened,
)
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.run_pictures import (
    MOST_PICTURES,
    NO_PICTURES,
    PictureEntry,
    PictureIndex,
    moments_in,
    pictures_of,
    renewed_pictures,
    run_pictures,
    stored_pictures,
    write_frames,
)
from madrob_console.archive.scored import Scored, score_opened
from madrob_console.common.errors import MadrobError
from madrob_console.export.zip_file import is_safe_name
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.pages.camera_pictures import MOST_EMBEDDED
from madrob_console.pages.related_runs import RelatedRuns
from madrob_console.pages.report import report_html
from madrob_console.referee.protests import Protest
from recorder.bag import RawMessage
from tests.madrob_console.archive.frames import (
    COMPRESSED,
    FRONT,
    NS,
    RAW,
    SIDE_CAMERA,
    compressed,
    film,
    packed,
    pattern,
    raw,
    span,
    stream,
)
from tests.madrob_console.cli.typed import Madrob
from tests.madrob_console.recorded_runs import INCIDENT_AT, appealed
from tests.recorder.samples import (
    add_evidence,
)

Pixels = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]


@cache
def scored() -> Scored:
    """Of that run, with evidence or without."""
    return score_opened(appealed())


def index_of(folder: Path) -> tuple[PictureEntry, ...]:
    text = (folder / PICTURES_FOLDER / PICTURES_INDEX).read_bytes()
    return msgspec.json.decode(text, type=PictureIndex).pictures


def frames_of(folder: Path) -> set[tuple[str, float | None]]:
    """The frames that are nearest to a moment; one of several moments at once is one."""
    return {(entry.topic, entry.log_time) for entry in index_of(folder)}


def page_of(folder: Path) -> str:
    place = RelatedRuns().place_of(folder, scored())
    return report_html(scored(), "1", place, renewed_pictures(folder, scored()))


def test_each_event_and_each_incident_has_the_nearest_frame_of_each_camera(filmed: Path) -> None:
    before = check_run(RunPath(filmed))
    renewed_pictures(filmed, scored())
    assert check_run(RunPath(filmed)) == before
    index = index_of(filmed)
    events = [event.event.value for event in scored().result.events]
    assert [one.event for one in index[::2]] == [m.name for m in moments_in(scored())]
    assert {one.event for one in index} == {*events, "incident_collision"}
    for entry in index:
        assert (entry.problem, abs(entry.difference or 0.0) < 0.05) == ("", True)
        with Image.open(filmed / PICTURES_FOLDER / entry.file) as picture:
            shown = (picture.format, picture.size, (entry.width, entry.height))
        assert shown == ("JPEG", (160, 120), (160, 120))
    files = {entry.file for entry in index}
    assert {path.name for path in (filmed / PICTURES_FOLDER).iterdir()} == {*files, PICTURES_INDEX}
    assert "01_benchmark_start_camera_front_image_compressed.jpg" in files
    incident, _ = (entry for entry in index if entry.event.startswith("inc"))
    assert incident.since_start == pytest.approx(INCIDENT_AT, abs=0.1)
    assert incident.words == "incident: collision"


def test_without_pillow_the_report_says_so_and_pictures_made_before_stay(
    filmed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fresh = shutil.copytree(filmed, filmed.parent / "fresh" / filmed.name)
    page_of(filmed)  # what draws is imported whole
    made = renewed_pictures(filmed, scored())
    monkeypatch.setitem(sys.modules, "PIL", None)
    assert renewed_pictures(filmed, scored()) == made == stored_pictures(filmed)
    assert made.files
    assert "need Pillow: install madrob-console with its extra `report`" in page_of(fresh)


def test_frames_in_the_folder_of_the_run_have_names_that_a_zip_takes(run: Path) -> None:
    long = "/hall_north/testbed/camera_beside_the_door/color/image_raw/compressed"
    film(run, f"{long}/left", f"{long}/right")
    assert write_frames(run, "-0.25", run / "frames") == []
    names = [item.name for item in (run / "frames").iterdir()]
    form = r"01_at_minus_0_250_s_.*_\d+_ms(_later|_earlier)?[.]jpg"
    assert [bool(re.fullmatch(form, one)) and is_safe_name(one) for one in names] == [True] * 2


def test_the_instant_that_a_protest_is_about_has_pictures(run: Path) -> None:
    film(run, FRONT)
    start = scored().result.start
    filed = Protest(1, start + 60, "Delft", "not open", "step 3", start + 4.2, "R. Eferee")
    protests = (filed, replace(filed, number=2, at=None))
    protested = replace(scored(), run=replace(scored().run, protests=protests))
    found = run_pictures(run, protested).index.pictures
    (shown,) = (entry for entry in found if entry.event.startswith("protest"))
    assert (shown.event, shown.words) == ("protest_1", "protest 1 (step 3)")
    assert shown.since_start == pytest.approx(4.2)
    assert shown.file.endswith("_protest_1_camera_front_image_compressed.jpg")


def test_a_report_and_its_copy_on_a_site_have_the_pictures_with_their_words(
    filmed: Path, tmp_path: Path, madrob: Madrob
) -> None:
    page = page_of(filmed)
    assert page_of(filmed) == page
    shown = re.findall(r'<img src="data:image/jpeg;base64,[^"]+" alt="([^"]+)"', page)
    assert len(shown) == len(frames_of(filmed))
    words = rf"Camera {FRONT} at 0\.00 s, run starts; received [0-9]+ ms (before|after) it\."
    assert re.fullmatch(words, shown[0])
    for told in (
        r"[-+][0-9]+ ms</b> <bdi>/camera/front",
        "What the cameras saw",
        "The time of a frame is that of its reception",
        '<a href="#moment-1">run starts</a>',
        "in the folder pictures",
    ):
        assert re.search(told, page), told
    targets = re.findall(r'href="(pictures/[^"]+)"', page)
    assert targets
    assert all((filmed / target).is_file() for target in targets)
    (filmed / "report.html").write_text(page)
    madrob("publish --practice", tmp_path / "site", filmed)
    copy = next((tmp_path / "site").glob("runs/*/report.html")).read_text()
    assert re.findall("<img [^>]*>", copy) == re.findall("<img [^>]*>", page)
    assert not re.search('in the folder pictures|href="pictures/', copy)


def test_moments_that_look_alike_share_their_pictures_and_a_mark_has_its_own(run: Path) -> None:
    first, *others = stream(FRONT, *span(run))
    add_evidence(run, [first, *(msgspec.structs.replace(one, data=first.data) for one in others)])
    page, index = page_of(run), index_of(run)
    assert len(frames_of(run)) == len(index) - 1 == 4
    assert page.count("<img ") == 2  # from the start on, and from the incident on
    for entry in index:
        assert page.count(f'id="moment-{entry.moment}">{entry.since_start:.2f} s: ') == 1


def test_a_page_stays_small_however_many_cameras_there_are(run: Path) -> None:
    when, large = span(run), (1280, 960)
    cameras = (stream(f"/camera_{n}", *when, rate=2, size=large) for n in range(12))
    add_evidence(run, [one for camera in cameras for one in camera])
    assert len(page_of(run)) < len(report_html(scored(), "1")) + 1.2 * MOST_EMBEDDED


def test_pictures_follow_the_evidence_and_stay_when_it_is_gone(run: Path) -> None:
    for topic in (FRONT, SIDE_CAMERA):
        evidence = film(run, topic)
        renewed_pictures(run, scored())
        evidence.unlink()
        assert {entry.topic for entry in index_of(run)} == {topic}
        assert len(list((run / PICTURES_FOLDER).iterdir())) == 1 + len(index_of(run))
        assert not list(run.glob(".pictures*"))
    page = page_of(run)
    assert page.count("<img ") == len(frames_of(run))
    assert "What the cameras saw" in page


@pytest.mark.parametrize("linked", [False, True])
def test_a_folder_of_somebody_else_s_is_not_replaced_nor_a_link_followed(
    *, linked: bool, filmed: Path, tmp_path: Path
) -> None:
    mine = tmp_path / "mine" if linked else filmed / PICTURES_FOLDER
    mine.mkdir()
    (mine / (PICTURES_INDEX if linked else "mine.txt")).write_text("{}")
    if linked:
        (filmed / PICTURES_FOLDER).symlink_to(mine)
    with pytest.raises(MadrobError, match="is no folder of pictures; move it away"):
        renewed_pictures(filmed, scored())
    assert [path.read_text() for path in mine.iterdir()] == ["{}"]


def test_a_camera_that_lies_or_is_silent_is_named_and_harms_no_other(run: Path) -> None:
    begin, end = span(run)
    good, late = stream(FRONT, begin, end), stream("/camera/late", begin, begin + 2)
    times = [message.receive_ns / NS for message in good]
    lies = [
        message
        for frame, at in zip(good, times, strict=True)
        for message in (
            compressed("/camera/bad", b"\x1b[2Jnone", at, at),
            raw(b"", "rgb8", 9**9, 9**9, 4, topic="/camera/huge", stamp=at, log=at),
            msgspec.structs.replace(frame, topic="/camera/torn", data=frame.data[:1000]),
        )
    ]
    add_evidence(run, [*good, *lies, *late])
    garbage = add_evidence(run, late, 1)
    garbage.write_bytes(b"garbage <script>")
    page = page_of(run)
    found = {entry.topic: entry.problem for entry in index_of(run) if entry.moment == 2}
    assert found.pop("/camera/huge").startswith("it claims 387420489 x 387420489 pixels")
    named = {
        FRONT: "",
        "/camera/bad": "it is neither JPEG nor PNG",
        "/camera/torn": f"its bytes are no {COMPRESSED}",
    }
    assert found.items() >= named.items()
    said = r"</bdi>: no picture at \d+ of \d+ moments, "
    for words in (
        rf"<bdi>/camera/bad{said}it is neither JPEG nor PNG",
        rf"<bdi>/camera/late{said}no frame within 1 s\.",
        f"<bdi>{FRONT}</bdi>",
        f"{garbage.name}: it does not begin like an MCAP file",
    ):
        assert re.search(words, page), words
    assert page.count("it is neither JPEG nor PNG") == 1


def test_the_work_and_its_pictures_are_bounded_and_what_is_left_is_said(
    filmed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    moments, ticks = moments_in(scored()), count(step=12)
    slow = pictures_of(filmed, moments, DEFAULT_MAPPINGS, monotonic=lambda: float(next(ticks)))
    assert 0 < len(slow.files) < 2 * len(moments)
    assert "pictures were not made" in slow.index.problems[0]
    assert MOST_PICTURES == 200
    monkeypatch.setattr("madrob_console.archive.run_pictures.MOST_PICTURES", 3)
    few = run_pictures(filmed, scored())
    assert (len(few.files), "at most 3" in few.index.problems[0]) == (3, True)


def test_an_index_that_lies_reads_no_other_file(run: Path) -> None:
    film(run, FRONT)
    renewed_pictures(run, scored())
    (run / "secret.jpg").write_bytes(b"secret")
    place, (first, *_) = run / PICTURES_FOLDER / PICTURES_INDEX, index_of(run)
    for file in ("../secret.jpg", "/etc/passwd", "..", "."):
        lie = msgspec.structs.replace(first, file=file)
        place.write_bytes(msgspec.json.encode(PictureIndex(pictures=(lie,))))
        assert stored_pictures(run).files == {}
    for text in (b"", b"{", b"[" * 100_000, b'{"pictures": 3}', b"\xff\xfe"):
        place.write_bytes(text)
        assert stored_pictures(run) is NO_PICTURES


# ---------------------------------------------------------------- a picture of a message


def message(data: bytes, told: str = "jpeg") -> RawMessage:
    return compressed("/camera", data, 1.0, 1.0, told)


COLOURS = (
    np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [250, 250, 250]]], dtype=np.uint8)
    .repeat(8, axis=0)
    .repeat(8, axis=1)
)
"""Squares of red, green, blue and white, of 8 x 8 pixels each."""


BGR = COLOURS[..., ::-1]
OPAQUE = np.full((16, 16, 1), 7, np.uint8)
LONG_ROWS = np.zeros((16, 16), np.uint8)


@pytest.mark.parametrize(
    ("encoding", "step", "parts"),
    [
        ("rgb8", 48, [COLOURS]),
        ("bgr8", 48, [BGR]),
        ("8UC3", 48, [BGR]),
        ("rgba8", 64, [np.dstack([COLOURS, OPAQUE])]),
        ("bgra8", 64, [np.dstack([BGR, OPAQUE])]),
        ("rgb8", 64, [COLOURS.reshape(16, 48), LONG_ROWS]),  # rows longer than their pixels
    ],
)
def test_raw_pictures_have_their_colours(encoding: str, step: int, parts: list[Pixels]) -> None:
    data = np.hstack(parts).tobytes()
    picture = decoded(raw(data, encoding, 16, 16, step)).convert("RGB").resize((16, 16))
    for place, meant in {(4, 4): (255, 0, 0), (12, 4): (0, 255, 0), (4, 12): (0, 0, 255)}.items():
        assert np.abs(np.array(picture.getpixel(place)) - meant).max() < 40


def test_grey_of_one_byte_is_as_it_is() -> None:
    grey = decoded(raw(bytes([1, 2, 3, 4]), "mono8", 2, 2, 2))
    assert np.asarray(grey).ravel().tolist() == [1, 2, 3, 4]


@pytest.mark.parametrize("kind", ["JPEG", "PNG"])
@pytest.mark.parametrize("told", ["jpeg", "png", "bgr8; jpeg compressed bgr8", "", "\x1b[2Jlie"])
def test_what_a_compressed_picture_is_its_bytes_say(kind: str, told: str) -> None:
    picture = decoded(message(packed(pattern(3), kind), told))
    assert (picture.size, picture.mode) == ((160, 120), "RGB")


def test_a_large_picture_is_made_small_whatever_is_in_it() -> None:
    picture = decoded(message(packed(Image.effect_noise((3000, 2000), 90))))
    assert picture.size == (SIDE, SIDE * 2 // 3)
    made, noise = jpeg(picture), Image.effect_noise((960, 960), 255)
    assert len(made.data) <= MOST_BYTES
    assert opened(made.data).size == (made.width, made.height)
    assert [len(jpeg(noise, most).data) <= most for most in (100_000, 20_000, 1000)] == [True] * 3
    with pytest.raises(PictureError, match="smaller than 10 bytes"):
        jpeg(noise, 10)


def test_nothing_of_a_file_is_passed_on_but_the_picture() -> None:
    file, exif = io.BytesIO(), Image.Exif()
    exif[0x010E] = "SECRET"
    pattern(1).save(file, "JPEG", comment=b"SECRET", exif=exif)
    assert file.getvalue().count(b"SECRET") == 2
    assert b"SECRET" not in jpeg(decoded(message(file.getvalue()))).data


def _png(width: int, height: int, data: bytes = b"") -> bytes:
    """A PNG that claims a size, whatever is in it."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def _scans(count: int) -> bytes:
    file = io.BytesIO()
    pattern(1).save(file, "JPEG", progressive=True)
    begin, last, scan = file.getvalue()[:-2].rpartition(b"\xff\xda")
    return begin + (last + scan) * count + b"\xff\xd9"


HOSTILE: dict[str, tuple[RawMessage, str]] = {
    "empty": (message(b""), "it is empty"),
    "text": (message(b"no picture at all"), "neither JPEG nor PNG"),
    "another format": (message(packed(pattern(1), "BMP")), "neither JPEG nor PNG"),
    "cut": (message(packed(pattern(1))[:900]), "cannot be decoded"),
    "cut png": (message(packed(pattern(1), "PNG")[:300]), "cannot be decoded"),
    "bomb": (message(_png(30_000, 30_000, zlib.compress(bytes(10**6)))), "30000 x 30000 pixels"),
    "head of a bomb": (message(_png(60_000, 60_000)[:33]), "60000 x 60000 pixels, more than 24 me"),
    "head of a png": (message(_png(600, 600)[:33]), "it is a damaged PNG"),
    "head of a jpeg": (message(packed(pattern(1))[:20]), "it is a damaged JPEG"),
    "large": (message(_png(8000, 8000)), "claims 8000 x 8000 pixels, more than 24 megapixels"),
    "long": (message(_png(1_000_000, 1)), "more than 24 megapixels"),
    "lies": (message(_png(4000, 4000, zlib.compress(bytes(100)))), "cannot be decoded"),
    "scans": (message(_scans(150)), "more than 100 scans"),
    "no such encoding": (raw(bytes(4), "\x1b[2Jrgb", 1, 1, 3), "the encoding"),
    "another encoding": (raw(bytes(4), "32SC1", 1, 1, 4), "the encoding 32SC1 is not shown"),
    "too short": (raw(bytes(10), "rgb8", 100, 100, 300), "not in its 10 bytes"),
    "rows too short": (raw(bytes(30_000), "rgb8", 100, 100, 3), "in rows of 3 bytes"),
    "claims": (raw(bytes(10), "rgb8", 2**32 - 1, 2**32 - 1, 2**32 - 1), "megapixels"),
    "nothing": (raw(b"", "rgb8", 0, 0, 0), "claims 0 x 0 pixels"),
    **{
        f"raw {name}": (raw(bytes(8), name, 2, 2, 4), f"the encoding {name} is not shown")
        for name in ("mono16", "16UC1", "32FC1", "bayer_rggb8", "bayer_gbrg16", "yuyv")
    },
    "16 bits": (
        message(packed(Image.fromarray(np.zeros((4, 4), np.uint16)), "PNG")),
        "16 bits of grey are not sh",
    ),
    "large message": (message(bytes(MOST_MESSAGE + 1)), "32 MB, more than 32 MB"),
    "not of its type": (
        RawMessage("/c", COMPRESSED, b"\x00\x01\x00\x00\xff", 1, 1),
        "its bytes are no sensor_msgs",
    ),
    "another type": (RawMessage("/c", "std_msgs/msg/String", b"", 1, 1), "it is a std_msgs/msg/St"),
    "no message": (RawMessage("/c", RAW, b"", 1, 1), "its bytes are no sensor_msgs"),
}


def test_what_it_claims_is_unpacked_and_nothing_of_the_rest() -> None:
    endless = _png(10, 10, zlib.compress(bytes(10**8)))
    assert decoded(message(endless)).size == (10, 10)


@pytest.mark.parametrize("name", HOSTILE)
def test_a_picture_that_lies_is_named_in_one_line(name: str) -> None:
    sent, why = HOSTILE[name]
    with pytest.raises(PictureError) as caught:
        decoded(sent)
    told = str(caught.value)
    assert (why in told, told.isprintable(), len(told) < 200) == (True, True, True), told


def _changed(data: bytes) -> st.SearchStrategy[bytes]:
    return st.builds(
        lambda at, new, cut: (data[:at] + new + data[at + len(new) :])[: len(data) - cut],
        st.integers(0, len(data) - 1),
        st.binary(max_size=8),
        st.integers(0, len(data) // 2),
    )


SIZES = st.integers(0, 40) | st.integers(0, 2**32 - 1)
MESSAGES = st.one_of(
    st.builds(
        message,
        st.one_of(
            _changed(packed(pattern(1))),
            _changed(packed(pattern(1), "PNG")),
            st.binary(max_size=200),
        ),
        st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20),
    ),
    st.builds(
        raw,
        st.binary(max_size=400),
        st.sampled_from(
            [
                *("rgb8", "bayer_rggb8", "uyvy", "yuyv", "bgra8"),
                *("32FC1", "?"),
            ]
        ),
        SIZES,
        SIZES,
        SIZES,
        big=st.booleans(),
    ),
    st.builds(
        lambda data, kind: RawMessage("/c", kind, b"\x00\x01\x00\x00" + data, 1, 1),
        st.binary(max_size=300),
        st.sampled_from([COMPRESSED, RAW]),
    ),
)


@given(MESSAGES)
@settings(max_examples=600, deadline=None)
def test_whatever_a_message_is_there_is_a_small_picture_or_one_line(sent: RawMessage) -> None:
    said = ""
    try:
        picture = decoded(sent)
    except PictureError as error:
        said = str(error)
    else:
        assert max(picture.size) <= SIDE
        assert len(jpeg(picture).data) <= MOST_BYTES
    assert said.isprintable()
