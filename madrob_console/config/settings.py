"""All settings, and the file that holds them."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from msgspec.structs import asdict
from platformdirs import user_config_path

from madrob_console.config.problem_words import explain
from madrob_console.config.simulation import Simulated
from madrob_console.config.tables import (
    DEFAULT_START_POSES,
    Checks,
    Competition,
    ConsoleSettings,
    DoubtSettings,
    EngineSettings,
    FreshnessSettings,
    PlanSettings,
    ProtestSettings,
    RecordingSettings,
    Results,
    RosSettings,
    RunDefaults,
    SettingsTable,
    SourceSetting,
    StartPoseSetting,
    TeamSetting,
    ThresholdSettings,
    TopicSetting,
    start_pose_on,
)
from madrob_console.engine.live.limits import SensorLimits
from madrob_console.errors import MadrobError
from madrob_console.names import LONGEST_NAME, clean_name
from madrob_console.referee.protests import ProtestTimes
from scoring.protocol import DoubtLimits, Side, StartPose, Thresholds

if TYPE_CHECKING:
    from madrob_console.messages.codec import TopicMapping
    from madrob_console.testbeds.simulated.geometry import DoorGeometry


LARGEST_SETTINGS = 1_000_000
"""A longer text is none, characters; no more bytes of a file are read."""


class Settings(SettingsTable, frozen=True):
    """All settings; each has a default."""

    competition: Competition = Competition()
    run: RunDefaults = RunDefaults()
    teams: tuple[TeamSetting, ...] = ()
    plan: PlanSettings = PlanSettings()
    start_poses: tuple[StartPoseSetting, ...] = DEFAULT_START_POSES
    testbed: SourceSetting = SourceSetting()
    ros: RosSettings = RosSettings()
    protests: ProtestSettings = ProtestSettings()
    topics: tuple[TopicSetting, ...] = ()
    thresholds: ThresholdSettings = ThresholdSettings()
    doubt: DoubtSettings = DoubtSettings()
    freshness: FreshnessSettings = FreshnessSettings()
    checks: Checks = Checks()
    results: Results = Results()
    recording: RecordingSettings = RecordingSettings()
    console: ConsoleSettings = ConsoleSettings()
    engine: EngineSettings = EngineSettings()
    simulated: Simulated = Simulated()

    def __post_init__(self) -> None:
        _no_repetition("topics", [topic.signal.value for topic in self.topics])
        _no_repetition("teams", [str(team.subject) for team in self.teams])
        _no_repetition("start_poses", [pose.name for pose in self.start_poses])

    def testbed_name(self, host: str) -> str:
        """What the testbed is called (protocol section 2).

        Args:
            host: the name of this machine, for a testbed that was given none.
        """
        return self.testbed.name or clean_name(host[:LONGEST_NAME], "host")

    def team_names(self) -> dict[int, str]:
        """Subject number -> team."""
        return {team.subject: team.name for team in self.teams}

    def start_pose(self, side: Side) -> StartPose:
        """The first start pose on `side`."""
        return start_pose_on(side, self.start_poses)

    def scoring_thresholds(self) -> Thresholds:
        """The thresholds as `scoring` takes them."""
        return Thresholds(
            **asdict(self.thresholds),
            largest_skew=self.checks.largest_skew,
            rate=self.checks.rate,
            doubt=DoubtLimits(**asdict(self.doubt)),
        )

    def protest_times(self) -> ProtestTimes:
        """The deadlines for protests as the engine takes them."""
        return ProtestTimes(**asdict(self.protests))

    def door_geometry(self) -> DoorGeometry:
        """The simulated doorway, with the masks that belong to it."""
        return self.simulated.door.geometry(self.scoring_thresholds())

    def sensor_limits(self) -> SensorLimits:
        """The limits of a healthy testbed as the engine takes them."""
        c = self.checks
        rates = {"rate": c.rate, "least_rate": c.least_rate, "most_rate": c.most_rate}
        return SensorLimits(**asdict(self.freshness), **rates)

    def mappings(self) -> tuple[TopicMapping, ...]:
        """The topics of protocol section 3, with [[topics]] put over them.

        Raises:
            MadrobError: a field path is malformed, or two signals share a topic.
        """
        from madrob_console.messages.codec import DEFAULT_MAPPINGS

        settings = {topic.signal: topic for topic in self.topics}
        return tuple(_mapping(m, settings.get(m.signal)) for m in DEFAULT_MAPPINGS)


def default_settings_path() -> Path:
    """Where the settings are looked for when no file is named."""
    return user_config_path("madrob") / "madrob.toml"


def load_settings(path: Path | None = None) -> Settings:
    """Read the settings.

    Args:
        path: the file; None = the one at `default_settings_path()`, which may be missing.

    Raises:
        MadrobError: the file cannot be read or is not valid; names the key and the remedy.
    """
    file = default_settings_path() if path is None else path
    try:
        with file.open("rb") as opened:  # a pipe is fine: who names it means it
            content = opened.read(LARGEST_SETTINGS + 1)
        return parse_settings(content.decode())
    except FileNotFoundError:
        if path is None:
            return Settings()
        raise MadrobError(f"{file}: no such settings file; correct --settings") from None
    except OSError as error:
        raise MadrobError(
            f"{file}: cannot be read ({error.strerror}); name a file with --settings"
        ) from None
    except UnicodeDecodeError:
        raise MadrobError(f"{file}: is not text; save it as UTF-8") from None
    except MadrobError as error:
        raise MadrobError(f"{file}: {error}") from None


def parse_settings(text: str) -> Settings:
    """The settings that a TOML text holds.

    Raises:
        MadrobError: it is not valid; names the key and the remedy.
    """
    if len(text) > LARGEST_SETTINGS:
        raise MadrobError("has more than 1 MB, no settings; name a file with --settings")
    try:
        content = tomllib.loads(text)
        return msgspec.convert(content, Settings)
    except msgspec.ValidationError as error:
        problem = explain(str(error), Settings, content)
        raise MadrobError(f"{problem}; correct or remove it") from None
    except (ValueError, RecursionError) as error:  # also numbers and brackets without end
        raise MadrobError(f"is not TOML: {error}") from None


def _no_repetition(key: str, names: list[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{key}: {name!r} stands there twice, keep one")


def _mapping(default: TopicMapping, setting: TopicSetting | None) -> TopicMapping:
    if setting is None:
        return default
    given = {key: value for key, value in asdict(setting).items() if value is not None}
    try:
        return replace(default, **given)
    except MadrobError as error:
        raise MadrobError(f"settings, [[topics]] {setting.signal.value}: {error}") from None
