"""The pictures of a run, in a folder of their own and in its report."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from io import BytesIO
from itertools import count
from pathlib import Path
from typing import Any

import msgspec
import pytest
from PIL import Image

from madrob_console.archive.check import check_run
from madrob_console.archive.folders import PICTURES_FOLDER, PICTURES_INDEX
from madrob_console.archive.run_paths import RunPath
from madrob_console.archive.scored import Scored, score_opened
from madrob_console.cameras.run_pictures import (
    MOST_PICTURES,
    NO_PICTURES,
    PictureEntry,
    PictureIndex,
    RunPictures,
    difference_words,
    moments_in,
    pictures_of,
    renewed_pictures,
    run_pictures,
    stored_pictures,
)
from madrob_console.cli.main import main
from madrob_console.errors import MadrobError
from madrob_console.messages.codec import DEFAULT_MAPPINGS
from madrob_console.referee.protests import Protest
from madrob_console.report.camera_pictures import MOST_EMBEDDED, pictures
from madrob_console.report.page import report_html
from madrob_console.report.surroundings import Surroundings
from recorder.bag import is_evidence
from tests.madrob_console.cameras.frames import COMPRESSED, NS, compressed, film, raw, span, stream
from tests.madrob_console.recorded_runs import INCIDENT_AT, appealed
from tests.recorder.samples import add_evidence

FRONT, SIDE = "/camera/front/image/compressed", "/camera/side"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run with an incident, without evidence, that a test may change."""
    return Path(shutil.copytree(appealed(), tmp_path / appealed().name))


def index_of(folder: Path) -> PictureIndex:
    text = (folder / PICTURES_FOLDER / PICTURES_INDEX).read_bytes()
    return msgspec.json.decode(text, type=PictureIndex)


def page_of(folder: Path, scored: Scored) -> str:
    place = Surroundings().place_of(folder, scored)
    page = report_html(scored, "1", place, renewed_pictures(folder, scored))
    return page.replace("<wbr>", "")


def test_each_event_and_each_incident_has_the_nearest_frame_of_each_camera(run: Path) -> None:
    film(run, FRONT, SIDE)
    scored = score_opened(run)
    renewed_pictures(run, scored)
    index = index_of(run)
    events = [event.event.value for event in scored.result.events]
    assert [one.event for one in index.pictures[::2]] == [m.name for m in moments_in(scored)]
    assert {one.event for one in index.pictures} == {*events, "incident_collision"}
    for entry in index.pictures:
        assert entry.problem == ""
        assert entry.difference is not None
        assert abs(entry.difference) < 0.05
        assert entry.clock.startswith("camera clock +0.1")
        with Image.open(run / PICTURES_FOLDER / entry.file) as picture:
            assert picture.format == "JPEG"
            assert picture.size == (entry.width, entry.height) == (160, 120)
    files = {entry.file for entry in index.pictures}
    assert {path.name for path in (run / PICTURES_FOLDER).iterdir()} == {*files, PICTURES_INDEX}
    assert "01_benchmark_start_camera_front_image_compressed.jpg" in files
    (incident,) = (e for e in index.pictures if e.event.startswith("inc") and e.topic == SIDE)
    assert incident.since_start == pytest.approx(INCIDENT_AT, abs=0.1)
    assert incident.words == "incident: collision"


def test_the_instant_that_a_protest_is_about_has_pictures(run: Path) -> None:
    film(run, FRONT)
    scored = score_opened(run)
    filed = Protest(
        1, scored.result.start + 60, "Delft", "not open", "step 3", scored.result.start + 4.2,
        scored.result.start + 90, "", "R. Eferee",
    )  # fmt: skip
    unnamed = replace(filed, number=2, at=None)
    seen = run_pictures(
        run, replace(scored, run=replace(scored.run, protests=(filed, unnamed)))
    ).index.pictures
    (shown,) = (entry for entry in seen if entry.event.startswith("protest"))
    assert (shown.event, shown.words) == ("protest_1", "protest 1 (step 3)")
    assert shown.since_start == pytest.approx(4.2)
    assert shown.file.endswith("_protest_1_camera_front_image_compressed.jpg")


def test_a_run_without_evidence_is_as_it_was(run: Path) -> None:
    scored = score_opened(run)
    place = Surroundings().place_of(run, scored)
    before = {path.name: path.read_bytes() for path in run.iterdir()}
    assert renewed_pictures(run, scored) is NO_PICTURES
    assert page_of(run, scored) == report_html(scored, "1", place)
    assert {path.name: path.read_bytes() for path in run.iterdir()} == before


def test_pictures_change_no_result_and_no_check(run: Path) -> None:
    before = check_run(RunPath(run))
    film(run, FRONT)
    renewed_pictures(run, score_opened(run))
    assert check_run(RunPath(run)) == before


def test_the_page_has_small_pictures_with_words_for_who_cannot_see_them(run: Path) -> None:
    film(run, FRONT)
    page = page_of(run, score_opened(run))
    assert "What the cameras saw" in page
    pictures = re.findall(r'<img src="data:image/jpeg;base64,[^"]+" alt="([^"]+)"', page)
    assert len(pictures) == len(index_of(run).pictures)
    assert re.fullmatch(
        rf"Camera {FRONT} at 0\.00 s, run starts; taken [0-9]+ ms (before|after) it\.", pictures[0]
    )
    assert re.search(r"[-+][0-9]+ ms</b> <bdi>/camera/front", page)
    assert "against the testbed&#x27;s" in page
    assert '<a href="#moment-1">run starts</a>' in page
    for target in re.findall(r'href="(pictures/[^"]+)"', page):
        assert (run / target).is_file()


def test_the_same_run_gives_the_same_page(run: Path) -> None:
    film(run, FRONT)
    scored = score_opened(run)
    assert page_of(run, scored) == page_of(run, scored)


def test_a_page_stays_small_however_many_cameras_there_are(run: Path) -> None:
    begin, end = span(run)
    sent = [
        one
        for number in range(12)
        for one in stream(f"/camera_{number}", begin, end, rate=2, size=(1280, 960))
    ]
    add_evidence(run, sent)
    scored = score_opened(run)
    without = len(report_html(scored, "1"))
    assert len(page_of(run, scored)) < without + 1.2 * MOST_EMBEDDED


def test_a_report_on_a_site_has_the_pictures_and_no_word_of_what_is_not_there(
    run: Path, tmp_path: Path
) -> None:
    film(run, FRONT)
    page = page_of(run, score_opened(run))
    (run / "report.html").write_text(page)
    assert main(["publish", str(tmp_path / "site"), str(run), "--practice"]) == 0
    copy = next((tmp_path / "site").glob("runs/*/report.html")).read_text()
    assert re.findall("<img [^>]*>", copy) == re.findall("<img [^>]*>", page)
    assert "in the folder pictures" in page
    assert "in the folder pictures" not in copy
    assert 'href="pictures/' not in copy


def test_pictures_are_made_anew_and_old_ones_go(run: Path) -> None:
    evidence = film(run, FRONT)
    scored = score_opened(run)
    renewed_pictures(run, scored)
    evidence.unlink()
    film(run, SIDE)
    renewed_pictures(run, scored)
    names = [path.name for path in (run / PICTURES_FOLDER).iterdir()]
    assert any("camera_side" in name for name in names)
    assert not any("camera_front" in name for name in names)
    assert not any(path.name.startswith(".pictures") for path in run.iterdir())


def test_pictures_stay_when_the_evidence_is_gone(run: Path) -> None:
    film(run, FRONT)
    scored = score_opened(run)
    page = page_of(run, scored)
    for path in run.iterdir():
        if is_evidence(path.name):
            path.unlink()
    assert "What the cameras saw" in page_of(run, scored)
    shown = re.findall("<img [^>]*>", page)
    assert re.findall("<img [^>]*>", page_of(run, scored)) == shown


def test_a_folder_of_somebody_else_s_is_not_replaced(run: Path) -> None:
    film(run, FRONT)
    (run / PICTURES_FOLDER).mkdir()
    (run / PICTURES_FOLDER / "mine.txt").write_text("mine")
    with pytest.raises(MadrobError, match="is no folder of pictures; move it away"):
        renewed_pictures(run, score_opened(run))
    assert (run / PICTURES_FOLDER / "mine.txt").read_text() == "mine"


def test_a_link_in_place_of_the_folder_is_not_followed(run: Path, tmp_path: Path) -> None:
    film(run, FRONT)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / PICTURES_INDEX).write_text("{}")
    (run / PICTURES_FOLDER).symlink_to(elsewhere)
    with pytest.raises(MadrobError, match="is no folder of pictures"):
        renewed_pictures(run, score_opened(run))
    assert [path.name for path in elsewhere.iterdir()] == [PICTURES_INDEX]


def test_a_camera_that_lies_is_named_and_harms_no_other(run: Path) -> None:
    begin, end = span(run)
    good = stream(FRONT, begin, end)
    bad = [
        compressed("/camera/bad", b"\x1b[2Jnone", m.receive_ns / NS, m.receive_ns / NS)
        for m in good
    ]
    huge = [
        raw(b"", "rgb8", 9**9, 9**9, 4, topic="/camera/huge", stamp=at, log=at)
        for at in (m.receive_ns / NS for m in good)
    ]
    torn = [
        msgspec.structs.replace(m, topic="/camera/torn", data=m.data[: len(m.data) // 2])
        for m in good
    ]
    add_evidence(run, [*good, *bad, *huge, *torn])
    scored = score_opened(run)
    page = page_of(run, scored)
    found = {e.topic: e for e in index_of(run).pictures if e.moment == 2}
    assert found[FRONT].problem == ""
    assert found["/camera/bad"].problem == "it is neither JPEG nor PNG"
    assert found["/camera/huge"].problem.startswith("it claims 387420489 x 387420489 pixels")
    assert found["/camera/torn"].problem == f"its bytes are no {COMPRESSED}"
    assert re.search(
        r"<bdi>/camera/bad</bdi>: no picture at \d+ of \d+ moments, it is neither", page
    )
    assert page.count("it is neither JPEG nor PNG") == 1
    assert f"<bdi>{FRONT}</bdi>" in page


def test_a_camera_that_saw_nothing_near_is_said_so(run: Path) -> None:
    begin, _ = span(run)
    add_evidence(run, stream(FRONT, begin, begin + 2))
    page = page_of(run, score_opened(run))
    assert re.search(r"no picture at \d+ of \d+ moments, no frame within 1 s\.", page)


def test_evidence_that_nobody_can_read_is_named_in_the_page(run: Path) -> None:
    evidence = film(run, FRONT)
    evidence.write_bytes(b"garbage <script>")
    page = page_of(run, score_opened(run))
    assert f"{evidence.name}: it does not begin like an MCAP file" in page


def test_the_work_ends_in_time_and_says_what_is_left(run: Path) -> None:
    film(run, FRONT, SIDE)
    scored = score_opened(run)
    ticks = count(step=12)
    made = pictures_of(
        run, moments_in(scored), DEFAULT_MAPPINGS, monotonic=lambda: float(next(ticks))
    )
    assert 0 < len(made.files) < 2 * len(moments_in(scored))
    assert "pictures were not made" in made.index.problems[0]


def test_there_are_never_more_pictures_than_are_bounded(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("madrob_console.cameras.run_pictures.MOST_PICTURES", 3)
    assert MOST_PICTURES == 200
    film(run, FRONT, SIDE)
    made = run_pictures(run, score_opened(run))
    assert len(made.files) == 3
    assert "at most 3" in made.index.problems[0]


def test_an_index_that_lies_reads_no_other_file(run: Path) -> None:
    film(run, FRONT)
    scored = score_opened(run)
    renewed_pictures(run, scored)
    (run / "secret.jpg").write_bytes(b"secret")
    place = run / PICTURES_FOLDER / PICTURES_INDEX
    for file in ("../secret.jpg", "/etc/passwd", "..", "."):
        entry = msgspec.structs.replace(index_of(run).pictures[0], file=file)
        place.write_bytes(msgspec.json.encode(PictureIndex(pictures=(entry,))))
        assert stored_pictures(run).files == {}
    for text in (b"", b"{", b"[" * 100_000, b'{"pictures": 3}', b"\xff\xfe"):
        place.write_bytes(text)
        assert stored_pictures(run) is NO_PICTURES


def entry(moment: int, topic: str, **known: Any) -> PictureEntry:  # noqa: ANN401
    return PictureEntry(
        moment=moment, event="door_opens", words="door opens", time=1e9 + moment,
        since_start=float(moment), topic=topic, **known,
    )  # fmt: skip


def test_a_picture_far_from_its_event_is_set_apart() -> None:
    assert difference_words(entry(1, FRONT, difference=0.008)) == "+8 ms"
    assert difference_words(entry(1, FRONT, difference=0.389)) == "389 ms LATER"
    assert difference_words(entry(1, FRONT, difference=-0.389)) == "389 ms EARLIER"
    out = BytesIO()
    Image.new("RGB", (16, 16)).save(out, "JPEG")
    near, far = (
        entry(1, FRONT, file="near.jpg", difference=0.008),
        entry(2, FRONT, file="far.jpg", difference=0.389),
    )
    files = {one.file: out.getvalue() for one in (near, far)}
    page = pictures(RunPictures(PictureIndex(pictures=(near, far)), files))
    assert "<b>+8 ms</b>" in page
    assert '<b class="far">389 ms LATER</b>' in page


def test_a_camera_without_pictures_says_why_once() -> None:
    broken = [entry(moment, "/camera/broken", problem="no JPEG") for moment in range(1, 9)]
    once = entry(1, "/camera/late")
    told = pictures(RunPictures(PictureIndex(pictures=(*broken, once))))
    assert "<wbr>/camera<wbr>/broken</bdi>" in told
    page = told.replace("<wbr>", "")
    assert page.count("no JPEG") == 1
    assert "/camera/broken</bdi>: no picture at 8 of 8 moments, no JPEG." in page
    assert page.count('class="missing"') == 1
    assert "no frame within 1 s" in page
