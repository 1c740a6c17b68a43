from __future__ import annotations

import dataclasses
import json
import math
import tomllib
from pathlib import Path

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import SourceKind, ThemeName
from madrob_console.config import Settings, default_settings_path, load_settings, parse_settings
from madrob_console.config.settings_example import example_toml
from madrob_console.config.tables import Competition, ConsoleSettings, RunDefaults
from madrob_console.messages.mapping import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.referee.topic_health import SensorLimits
from madrob_console.testbeds.simulated.geometry import DoorGeometry
from madrob_console.testbeds.simulated.sensor_model import SensorSettings
from scoring.indicator_table import RulesetName
from scoring.protocol import GRAM_FORCE, LockDetection, Side, Signal, StartPose, Thresholds


def load(folder: Path, text: str) -> Settings:
    path = folder / "madrob.toml"
    path.write_text(text)
    return load_settings(path)


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    return tmp_path


def test_without_a_file_everything_is_as_the_protocol_has_it(home: Path) -> None:
    settings = load_settings()
    assert settings == Settings()
    assert settings.scoring_thresholds() == Thresholds()
    assert settings.mappings() == DEFAULT_MAPPINGS
    assert settings.sensor_limits() == SensorLimits()
    assert settings.door_geometry() == DoorGeometry()
    assert settings.simulated.sensors.settings() == SensorSettings()
    run = settings.run
    assert (run.timeout, run.countdown) == (300.0, 5.0)
    assert (run.lock_detection, run.ruleset) == (LockDetection.AUTO, RulesetName.PROTOCOL)
    assert [(pose.name, pose.pose) for pose in settings.start_poses] == [
        ("CCW, 1.5 m", StartPose(1.5, 0.0, 180.0)),
        ("CW, 1.5 m", StartPose(-1.5, 0.0, 0.0)),
    ]
    assert settings.checks.disk_space == 500_000_000
    assert settings.results.root == home / "madrob_runs"
    assert settings.competition.teams_path is None


def test_the_file_is_looked_for_in_the_users_configuration(home: Path) -> None:
    path = default_settings_path()
    assert path.is_relative_to(home)
    path.parent.mkdir(parents=True)
    path.write_text("[run]\ntimeout = 120\n")
    assert load_settings().run.timeout == 120


def test_a_file_changes_what_it_names(tmp_path: Path) -> None:
    settings = load(
        tmp_path,
        """
        [competition]
        name = "Robot  Cup\\u001b[31m"
        referee = "../Ada"
        teams_file = "~/cup/teams.csv"
        best_runs = 3
        [run]
        countdown = 3
        lock_detection = "referee"
        ruleset = "eurobench-2020"
        [[teams]]
        subject = 3
        name = "Walk-Man"
        [[teams]]
        subject = 12
        name = " a/b "
        [[start_poses]]
        name = "far"
        x = 2
        yaw = 170.5
        [testbed]
        kind = "ros"
        domain = 7
        [thresholds]
        touch_force = 3
        mask_from = [0, 0, 0, 0, 0]
        [freshness]
        lost = 4
        [checks]
        rate = 100
        largest_skew = 0.2
        [results]
        folder = "/data/runs"
        [console]
        theme = "high-contrast"
        bell = false
        mouse = false
        [simulated.door]
        doorway_width = 1.2
        [simulated.sensors]
        latch = true
        """,
    )
    assert settings.competition == Competition(
        name="Robot Cup", referee="Ada", teams_file="~/cup/teams.csv", best_runs=3
    )
    assert settings.competition.teams_path == Path.home() / "cup" / "teams.csv"
    assert settings.run == RunDefaults(
        countdown=3.0,
        timeout=300.0,
        lock_detection=LockDetection.REFEREE,
        ruleset=RulesetName.EUROBENCH_2020,
    )
    assert settings.team_names() == {3: "Walk-Man", 12: "a b"}
    assert [(p.name, p.pose) for p in settings.start_poses] == [("far", StartPose(2, 0, 170.5))]
    assert settings.start_pose(Side.CCW) == StartPose(2, 0, 170.5)
    assert settings.start_pose(Side.CW) == StartPose(-1.5, 0, 0)
    assert (settings.testbed.kind, settings.testbed.domain) == (SourceKind.ROS, 7)
    assert settings.scoring_thresholds() == Thresholds(
        touch_force=3.0, mask_from=(0, 0, 0, 0, 0), largest_skew=0.2, rate=100.0
    )
    assert settings.sensor_limits() == SensorLimits(lost=4.0, rate=100.0)
    assert settings.results.root == Path("/data/runs")
    assert settings.console == ConsoleSettings(
        theme=ThemeName.HIGH_CONTRAST, bell=False, mouse=False
    )
    assert settings.door_geometry() == DoorGeometry(
        doorway_width=1.2, thresholds=settings.scoring_thresholds()
    )
    assert settings.simulated.sensors.settings() == SensorSettings(latch=True)


def test_a_testbed_with_other_messages_needs_no_code(tmp_path: Path) -> None:
    settings = load(
        tmp_path,
        """
        [[topics]]
        signal = "handle force"
        topic = "/handle"
        type = "madrob_msgs/msg/Handle"
        field = "force"
        scale = 0.00980665
        largest = 2000
        [[topics]]
        signal = "door angle"
        offset = 0.5
        """,
    )
    mappings = {mapping.signal: mapping for mapping in settings.mappings()}
    assert mappings[Signal.HANDLE] == TopicMapping(
        Signal.HANDLE, "/handle", "madrob_msgs/msg/Handle", "force", GRAM_FORCE, largest=2000
    )
    door = next(m for m in DEFAULT_MAPPINGS if m.signal is Signal.DOOR)
    assert mappings[Signal.DOOR] == dataclasses.replace(door, offset=0.5)
    unchanged = set(Signal) - {Signal.HANDLE, Signal.DOOR}
    assert {m for m in DEFAULT_MAPPINGS if m.signal in unchanged} < set(mappings.values())


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('field = "a..b"', "'a..b' is no field"),
        ('field = "a[100000000]"', "no message has so many elements"),
        ('no_echo = "none"', "no_echo 'none' is no number"),
    ],
)
def test_a_malformed_field_names_its_topic_entry(tmp_path: Path, line: str, words: str) -> None:
    settings = load(tmp_path, f'[[topics]]\nsignal = "latch"\n{line}\n')
    with pytest.raises(MadrobError, match=rf"^settings, \[\[topics\]\] latch: .*{words}"):
        settings.mappings()


def test_a_value_may_be_in_another_unit_and_a_strip_may_be_four_topics(tmp_path: Path) -> None:
    settings = load(
        tmp_path,
        """
        [[topics]]
        signal = "door angle"
        scale = -1.0
        offset = 90.0
        unit = "deg"
        [[topics]]
        signal = "passage cw left"
        topics = ["/lab/r0", "/lab/r1", "/lab/r2", "/lab/r3"]
        type = "sensor_msgs/msg/Range"
        field = "range"
        unit = "mm"
        """,
    )
    door, _, *strip = settings.mappings()[:6]
    assert door.scale == -math.pi / 180
    assert door.offset == pytest.approx(math.pi / 2)
    one = TopicMapping(Signal.CW_LEFT, "", "sensor_msgs/msg/Range", "range", scale=0.001)
    assert strip == [dataclasses.replace(one, topic=f"/lab/r{place}") for place in range(4)]


@pytest.mark.parametrize("written", ["0", '"0"', "nan", '"nan"'])
def test_what_says_that_nothing_is_there_is_a_number_or_its_text(
    tmp_path: Path, written: str
) -> None:
    settings = load(tmp_path, f'[[topics]]\nsignal = "passage cw left"\nno_echo = {written}\n')
    mappings = {mapping.signal: mapping.no_echo for mapping in settings.mappings()}
    assert float(mappings[Signal.CW_LEFT]) == pytest.approx(float(written.strip('"')), nan_ok=True)
    assert mappings[Signal.CW_RIGHT] == "inf"


def test_the_file_names_the_topics_that_are_recorded_beside_the_run(tmp_path: Path) -> None:
    topics = ("/camera/left/image/compressed", "/tf")
    assert Settings().evidence.topics == ()
    assert load(tmp_path, f"[evidence]\ntopics = {list(topics)}").evidence.topics == topics


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[run]\ntimeout = 'long'", "run.timeout: expected a number, got text"),
        ("[run]\ntimeout = true", "run.timeout: expected a number, got true or false"),
        ("[run]\ntimeout = nan", "run.timeout: expected a number >= 1.0"),
        ("[run]\ntimeout = inf", "run.timeout: expected a number <= 86400.0"),
        ("[run]\ntimeout = -1", "run.timeout: expected a number >= 1.0"),
        (
            "[run]\nruleset = 'mine'",
            "run.ruleset: invalid enum value 'mine'; use 'protocol', 'eurobench-2020'",
        ),
        (
            "[run]\ntimout = 3",
            "'run.timout': no such setting; there are timeout, countdown, lock_detection, ruleset",
        ),
        (
            "[rum]",
            "'rum': no such setting; there are competition, run, teams, plan, start_poses",
        ),
        ("[run]\nruleset = 'a\\n\\u001b[2J'".replace("'", '"'), "run.ruleset: invalid enum value"),
        ("run = 3", "run: expected a table, got a whole number"),
        ("[[start_poses]]\nname = 'a'", "start_poses[0]: missing `x`"),
        ("[[start_poses]]\nname = 'a'\nx = 0", "start_poses[0]: x: 0 is on the threshold"),
        ("[[teams]]\nsubject = 0", "teams[0].subject: expected a whole number >= 1"),
        ("[[teams]]\nsubject = 1\nname = '" + "x" * 99 + "'", "team has 99 characters: use at"),
        ("[[teams]]\nsubject = 1\nname = 'a'\n" * 2, "settings: teams: '1' stands there twice"),
        ("[testbed]\nkind = 'replay'", "testbed: kind: a replay needs its bag, use"),
        ("[testbed]\ndomain = 233", "testbed.domain: expected a whole number <= 232"),
        ("[testbed]\ndomain = 'a'", "testbed.domain: expected a whole number, got text"),
        (
            "[[topics]]\nsignal = 'latch'\n[[topics]]\nsignal = 'wind'",
            "topics[1].signal: invalid enum value 'wind'; use 'door angle', 'handle force', ",
        ),
        ("[[topics]]\ntopic = '/a'", "topics[0]: missing `signal`"),
        (
            "[[topics]]\nsignal = 'latch'\ntopic = 'a'",
            "topics[0].topic: 'a' is no name of a topic: ",
        ),
        ("[[topics]]\nsignal = 'latch'\ntype = 'a/B'", "topics[0].type: 'a/B' is no message type"),
        (
            "[evidence]\ntopics = ['/a', 'b']",
            "evidence.topics[1]: 'b' is no name of a topic: at most 200 characters, of words ",
        ),
        ("[evidence]\ntopics = ['/a//b']", "evidence.topics[0]: '/a//b' is no name of a topic"),
        ("[evidence]\ntopics = ['/" + "a" * 200 + "']", "evidence.topics[0]: '/aaa"),
        (
            "[evidence]\ntopics = ['/a', '/b', '/a']",
            "settings: evidence.topics: '/a' stands there twice, keep one",
        ),
        ("[evidence]\ntopics = ['/" + "-" * 999 + "']", "evidence.topics[0]: '/------------"),
        ("[[topics]]\nsignal = 'latch'\nscale = 0", "topics[0]: scale: 0 loses the signal"),
        (
            "[[topics]]\nsignal = 'latch'\ntype = 'a/msg/B'",
            "topics[0]: field: name the field of a/msg/B",
        ),
        (
            "[[topics]]\nsignal = 'latch'\n[[topics]]\nsignal = 'latch'",
            "settings: topics: 'latch' stands there twice, keep one",
        ),
        (
            "[[topics]]\nsignal = 'handle force'\nunit = 'deg'",
            "topics[0]: unit: 'deg' is none of handle force; use N, gf, kgf",
        ),
        (
            "[[topics]]\nsignal = 'latch'\ntopics = ['/a', '/b', '/c']",
            "topics[0].topics: expected ",
        ),
        (
            "[[topics]]\nsignal = 'passage cw left'\ntopics = ['/a', '/b', '/c', '/d']",
            "topics[0]: topics: name their type and field",
        ),
        (
            "[[topics]]\nsignal = 'latch'\nunits = 1",
            "'topics[0].units': no such setting; there are",
        ),
        ("[thresholds]\nmask_from = [0]", "thresholds.mask_from: expected a list of length 5"),
        (
            "[thresholds]\nmask_from = [0, 0, 0, 0, nan]",
            "thresholds.mask_from[4]: expected a number >= 0.0",
        ),
        ("[thresholds]\npresent_height = 3", "thresholds: present_height: must be below"),
        ("[freshness]\nlost = 0.1", "freshness: lost: must not be below fresh"),
        ("[results]\nfolder = 'runs'", "results: folder: begin it with / or ~/"),
        ("[results]\nfolder = '~nobody-of-that-name/a'", "results: folder: begin it with / or ~/"),
        (
            "[competition]\nteams_file = 'teams.csv'",
            "competition: teams_file: begin it with / or ~/",
        ),
        (
            "[competition]\nbest_runs = 101",
            "competition.best_runs: expected a whole number <= 100",
        ),
        (
            "[console]\ntheme = 'solarized'",
            "console.theme: invalid enum value 'solarized'; use 'dark', 'light', 'high-contrast'",
        ),
        ("[console]\nbell = 'no'", "console.bell: expected true or false, got text"),
        ("[results]\nfolder = ''", "results.folder: expected text of length >= 1"),
        ("[plan]\nruns = [[3, 21, 1]]", "plan.runs[0][1]: expected a whole number <= 20"),
        ("[plan]\nruns = [[3, 1]]", "plan.runs[0]: expected a list of length 3, got 2"),
        ("[plan]\nfile = '/a'\nruns = [[3, 1, 1]]", "plan: runs: the file says it, keep one"),
        ("[plan]\nfile = 'a.csv'", "plan: file: begin it with / or ~/"),
        ("[competition]\nreferee = '" + "x" * 99 + "'", "referee has 99 characters: use at most"),
        ("[run", "is not TOML: "),
        ("a = " + "[" * 99_999, "is not TOML: "),
        ("a = " + "9" * 9_999, "is not TOML: "),
        ("#" * 1_000_001, "has more than 1 MB"),
    ],
)
def test_what_is_wrong_is_one_line_that_names_file_and_key(
    tmp_path: Path, text: str, reason: str
) -> None:
    with pytest.raises(MadrobError) as caught:
        load(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'madrob.toml'}: {reason}")
    assert message.isprintable()


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(MadrobError, match=r"none.toml: no such settings file; correct --settings"):
        load_settings(tmp_path / "none.toml")
    with pytest.raises(MadrobError, match=r"cannot be read \(Is a directory\)"):
        load_settings(tmp_path)
    (tmp_path / "latin").write_bytes(b"a = '\xff'")
    with pytest.raises(MadrobError, match=r"latin: is not text; save it as UTF-8"):
        load_settings(tmp_path / "latin")


@given(
    st.dictionaries(
        st.sampled_from(["run", "topics", "checks", "x"]),
        st.recursive(
            st.booleans() | st.floats() | st.text(max_size=3),
            lambda inner: (
                st.lists(inner, max_size=2)
                | st.dictionaries(st.sampled_from(["timeout", "signal", "y"]), inner, max_size=2)
            ),
            max_leaves=4,
        ),
        max_size=2,
    )
)
def test_no_content_ends_in_a_traceback(data: dict[str, object]) -> None:
    text = "\n".join(f"{key} = {_toml(value)}" for key, value in data.items())
    try:
        settings = parse_settings(text)
    except MadrobError as error:
        assert "\n" not in str(error)  # noqa: PT017  either is right, a traceback is not
    else:
        assert isinstance(settings, Settings)


def test_the_example_shows_every_setting_with_its_default() -> None:
    example = example_toml()
    assert parse_settings(example) == Settings()
    assert max(map(len, example.splitlines())) <= 100
    lines = [line for line in example.splitlines() if not line.startswith("# ")]
    unset = [line for line in lines if " = ..." in line]
    text = "\n".join(line.removeprefix("#") for line in lines if line not in unset)
    assert parse_settings(text).topics[0].signal is Signal.HANDLE
    shown = tomllib.loads(text)
    defaults = msgspec.json.decode(msgspec.json.encode(Settings()))
    for listed in ("topics", "teams", "start_poses"):
        assert shown.pop(listed)
        del defaults[listed]
    assert [line.split()[0] for line in unset] == ["#name", "#kind", "#domain"]
    for unnamed in ("name", "kind", "domain"):
        assert defaults["testbed"].pop(unnamed) is None
    assert shown == defaults


def _toml(value: object) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value) if isinstance(value, str | bool) else repr(value)
