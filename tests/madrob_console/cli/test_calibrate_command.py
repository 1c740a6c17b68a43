"""`madrob calibrate` on recordings of the simulated testbed, whose truth is known."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from madrob_console.cli.testbed_calibration import (
    handle_toml,
    masks_of,
    masks_toml,
    sweep_recordings,
)
from madrob_console.config import Settings, parse_settings
from madrob_console.messages.mapping import DEFAULT_MAPPINGS
from madrob_console.testbeds.simulated.geometry import DoorGeometry
from madrob_console.testbeds.simulated.sensor_model import Reading, Scene, SensorSettings
from scoring.calibration import GRAVITY, HandleProposal, MaskProposal, PanelView, SteadyForce
from scoring.protocol import PASSAGE_SENSORS, Side, Signal
from tests.madrob_console.calibration_bags import record, record_handle, record_sweep, swing
from tests.madrob_console.cli.typed import Madrob

SPEED = 0.5
SLACK = SPEED / 50 + math.tau / 3600
"""rad: what the panel turns between two samples, and a step of the encoder."""


def half(sign: int, time: float) -> Scene:
    """The door swings to one side."""
    return Scene(angle=sign * swing(time, SPEED, 1.2, 1))


NEW = DoorGeometry(lintel_height=2.4, panel_height=2.1, sensor_distance=0.25, sensor_spacing=0.11)


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`sweep` of a testbed with other measures; `rest`, `pulled` and `pushed` of a handle in gf."""
    root = tmp_path_factory.mktemp("bags")
    record_sweep(root / "sweep", speed=SPEED, times=1, geometry=NEW)
    gram = GRAVITY / 1000
    record_handle(root / "rest", lambda _: 0.0, scale=gram)
    record_handle(root / "pulled", lambda _: 5 * GRAVITY, scale=gram, seed=1)
    record_handle(root / "pushed", lambda _: -5 * GRAVITY, scale=gram, seed=2)
    record_handle(root / "hand", lambda time: 5 * GRAVITY * (time > 2), scale=gram, seed=3)
    return root


# ---------------------------------------------------------------- masks


def test_the_masks_are_those_of_the_simulated_door(bags: Path) -> None:
    proposal = masks_of(sweep_recordings([bags / "sweep"], Settings()), Settings())
    assert proposal.lintel_height == pytest.approx(2.4, abs=0.002)
    for view in proposal.views:
        truth = NEW.panel_seen(NEW.mount(view.sensor))
        assert truth is not None
        assert (view.first, view.last) == pytest.approx(truth, abs=SLACK)


def test_the_proposal_says_per_sensor_what_it_rests_on(bags: Path, madrob: Madrob) -> None:
    target = bags / "masks.toml"
    said = madrob("calibrate masks", bags / "sweep", "--output", target)
    assert target.read_text() == said
    assert "# Door swept from -1.300 to 1.300 rad." in said
    for sensor in PASSAGE_SENSORS:
        name = f"# {sensor.side} {sensor.index} ({sensor.strip}[{sensor.element}])"
        (line,) = [line for line in said.splitlines() if line.startswith(name)]
        readings, under = map(int, line.split(")", 1)[1].split()[:2])
        assert readings > 500
        assert 10 < under < 100
    assert list(tomllib.loads(said)["thresholds"]) == [
        "lintel_height", "mask_from", "mask_to_cw", "mask_to_ccw",
    ]  # fmt: skip


def test_a_recording_of_each_side_counts_like_one_of_both(tmp_path: Path, madrob: Madrob) -> None:
    mappings = [m for m in DEFAULT_MAPPINGS[:-1] if m.signal is not Signal.HANDLE]
    for side in Side:
        record(tmp_path / side, partial(half, side.sign), 4.8, mappings=mappings)
    assert "to both sides" in madrob.refusal("calibrate masks", tmp_path / "cw")
    madrob("calibrate masks", tmp_path / "cw", tmp_path / "ccw")


def test_topics_types_and_units_are_those_of_the_settings(tmp_path: Path, madrob: Madrob) -> None:
    text = """
        [[topics]]
        signal = "door angle"
        topic = "/my/door"
        type = "std_msgs/msg/Float64"
        field = "data"
        scale = 0.017453292519943295
    """
    (tmp_path / "mine.toml").write_text(text)
    mappings = [m for m in parse_settings(text).mappings() if m.signal is not Signal.LATCH]
    record(tmp_path / "bag", partial(half, 1), 9.6, mappings=mappings)
    refusal = madrob.refusal("calibrate masks", tmp_path / "bag")
    assert "no messages on /madrob/door/angle (door angle)" in refusal
    said = madrob("calibrate masks", tmp_path / "bag", "--settings", tmp_path / "mine.toml")
    assert parse_settings(said).scoring_thresholds().lintel_height == 2.0


Spoil = Callable[[Signal, float, Reading], Reading | None]
SPOILT: dict[str, tuple[Spoil, str]] = {
    "a silent strip": (
        lambda signal, _time, reading: None if signal is Signal.CCW_LEFT else reading,
        "no messages on /madrob/passage/ccw_left",
    ),
    "a blind door": (
        lambda signal, _time, reading: math.nan if signal is Signal.DOOR else reading,
        "the door was swept from 0.00 to 0.00 rad",
    ),
}


@pytest.mark.parametrize("case", SPOILT)
def test_a_strip_that_says_nothing_and_a_door_without_numbers_are_refused(
    case: str, tmp_path: Path, madrob: Madrob
) -> None:
    spoil, words = SPOILT[case]
    record_sweep(tmp_path / "bag", times=1, sensors=SensorSettings(rate=20), spoil=spoil)
    assert words in madrob.refusal("calibrate masks", tmp_path / "bag")


# ---------------------------------------------------------------- handle


HANDLE = "calibrate handle --mass 5"


def test_scale_and_zero_are_those_of_the_simulated_handle_whatever_the_scale_so_far(
    bags: Path, madrob: Madrob
) -> None:
    said = madrob(HANDLE, bags / "rest", bags / "pulled")
    (topic,) = parse_settings(said).topics
    assert topic.signal is Signal.HANDLE
    assert topic.scale == pytest.approx(GRAVITY / 1000, rel=0.001)
    assert topic.offset == pytest.approx(-5.9, abs=0.02)
    assert "# rest: 200 samples, median 601" in said
    assert "WRONG" not in said
    (bags / "found.toml").write_text(said)
    assert madrob(HANDLE, bags / "rest", bags / "pulled", "--settings", bags / "found.toml") == said


def test_a_wrong_sign_is_said_in_words_and_mended(bags: Path, madrob: Madrob) -> None:
    said = madrob(HANDLE, bags / "rest", bags / "pushed")
    assert "# WRONG SIGN" in said
    assert parse_settings(said).topics[0].scale == pytest.approx(-GRAVITY / 1000, rel=0.001)
    assert "WRONG" not in madrob(f"{HANDLE} --towards cw", bags / "rest", bags / "pushed")


@pytest.mark.parametrize(
    ("first", "second", "words"),
    [
        ("rest", "hand", "weight: a noise of"),
        ("sweep", "rest", "no messages on /madrob/handle/force"),
    ],
)
def test_a_handle_that_is_touched_or_a_weight_that_is_none_is_refused(
    first: str, second: str, words: str, bags: Path, madrob: Madrob
) -> None:
    assert words in madrob.refusal(HANDLE, bags / first, bags / second)


# ---------------------------------------------------------------- settings

ANGLES = st.tuples(st.floats(0.03, 1.2), st.floats(0.0, 0.3))


@settings(max_examples=50)
@given(st.lists(st.none() | ANGLES, min_size=10, max_size=10), st.floats(0.6, 9.9))
def test_every_proposal_reads_back_to_the_same_masks(
    places: list[tuple[float, float] | None], lintel: float
) -> None:
    views = [
        PanelView(
            sensor=sensor, readings=999, under=50 if place else 0, strays=0,
            first=place and place[0], last=place and sum(place),
        )
        for sensor, place in zip(PASSAGE_SENSORS, places, strict=True)
    ]  # fmt: skip
    proposal = MaskProposal(tuple(views), round(lintel, 3), (-1.5, 1.5))
    read = parse_settings(masks_toml(proposal)).scoring_thresholds()
    assert read.lintel_height == proposal.lintel_height
    assert read.mask_from == proposal.mask_from
    assert (read.mask_to_cw, read.mask_to_ccw) == (
        proposal.mask_to(Side.CW),
        proposal.mask_to(Side.CCW),
    )
    for view in proposal.views:
        if view.first is not None and view.last is not None:
            sensor, sign = view.sensor, view.sensor.side.sign
            assert read.masked(sensor.side, sensor.index, sign * view.first)
            assert read.masked(sensor.side, sensor.index, sign * view.last)
        else:
            assert not read.masked(view.sensor.side, view.sensor.index, view.sensor.side.sign * 0.5)


@given(st.floats(1e-6, 1e6), st.floats(-1e3, 1e3), st.sampled_from([-1, 1]))
def test_every_handle_reads_back_to_the_same_force(scale: float, zero: float, sign: int) -> None:
    level = SteadyForce(200, zero, 0.1)
    proposal = HandleProposal(sign * scale, level, level)
    mapping = next(m for m in DEFAULT_MAPPINGS if m.signal is Signal.HANDLE)
    (topic,) = parse_settings(handle_toml(proposal, mapping)).topics
    assert topic.scale == pytest.approx(proposal.scale, rel=1e-8)
    assert topic.offset == pytest.approx(proposal.offset, rel=1e-8)
    assert (topic.topic, topic.type, topic.field) == (mapping.topic, mapping.type, mapping.field)
