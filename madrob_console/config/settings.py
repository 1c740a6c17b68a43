"""All settings: the file that holds them, and its errors in words."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
from msgspec import inspect
from msgspec.structs import asdict
from platformdirs import user_config_path

from madrob_console.common.errors import MadrobError
from madrob_console.common.names import LONGEST_NAME, clean_name, terminal_safe
from madrob_console.config.setting_types import SettingsTable, fields, plain, text_words, type_at
from madrob_console.config.tables import (
    DEFAULT_START_POSES,
    Checks,
    Competition,
    ConsoleSettings,
    EngineSettings,
    EvidenceSettings,
    FreshnessSettings,
    PlanSettings,
    Results,
    RunDefaults,
    Simulated,
    SourceSetting,
    StartPoseSetting,
    TeamSetting,
    ThresholdSettings,
    TopicSetting,
    start_pose_on,
)
from madrob_console.messages.mapping import DEFAULT_MAPPINGS, TopicMapping
from madrob_console.referee.run_setup import RunSetup
from madrob_console.referee.topic_health import SensorLimits
from scoring.protocol import Side, StartPose, Thresholds

if TYPE_CHECKING:
    from madrob_console.testbeds.simulated.geometry import DoorGeometry


_PLACE = re.compile(r"(?P<what>.*?)(?: - at `\$\.?(?P<key>.*)`)?")
_UNKNOWN = re.compile(r"Object contains unknown field `(.*)`")
_KEY_PART = re.compile(r"[^.\[\]]+")
_OTHERWISE = "Expected `str` matching regex"
_SHOWN = 60
_WORDS = {
    " | null": "",
    "Object missing required field": "missing",
    "`float`": "a number",
    "`int`": "a whole number",
    "`str`": "text",
    "`bool`": "true or false",
    "`object`": "a table",
    "`array`": "a list",
}


def explain(message: str, settings: type[msgspec.Struct], content: object) -> str:
    """Explains msgspec's `message` about a settings file, in one line that begins with the key."""
    message = terminal_safe(message)
    place = _PLACE.fullmatch(message)
    what, key = (place["what"], place["key"] or "") if place else (message, "")
    parts = _KEY_PART.findall(key)
    limited = type_at(inspect.type_info(settings), parts)
    kind = plain(limited)
    if what.startswith(_OTHERWISE):
        written = terminal_safe(repr(_value_at(content, parts)))
        return f"{key}: {written[:_SHOWN]} is no {text_words(limited)}"
    if unknown := _UNKNOWN.fullmatch(what):
        names = ", ".join(f.encode_name for f in fields(kind))
        name = f"{key}.{unknown[1]}".lstrip(".")
        return f"{name!r}: no such setting; there are {names}"
    if isinstance(kind, inspect.EnumType):
        what += "; use " + ", ".join(repr(member.value) for member in kind.cls)
    for word, ours in _WORDS.items():
        what = what.replace(word, ours)
    return f"{key or 'settings'}: {what[:1].lower()}{what[1:]}"


def _value_at(content: object, parts: Sequence[str]) -> object:
    for part in parts:
        match content:
            case dict():
                content = content[part]
            case list():
                content = content[int(part)]
    return content


LARGEST_SETTINGS = 1_000_000
"""Longest settings text, characters; at most so many bytes of a file are read."""


class Settings(SettingsTable, frozen=True):
    """All settings; each has a default."""

    competition: Competition = Competition()
    run: RunDefaults = RunDefaults()
    teams: tuple[TeamSetting, ...] = ()
    plan: PlanSettings = PlanSettings()
    start_poses: tuple[StartPoseSetting, ...] = DEFAULT_START_POSES
    testbed: SourceSetting = SourceSetting()
    topics: tuple[TopicSetting, ...] = ()
    thresholds: ThresholdSettings = ThresholdSettings()
    freshness: FreshnessSettings = FreshnessSettings()
    checks: Checks = Checks()
    results: Results = Results()
    evidence: EvidenceSettings = EvidenceSettings()
    console: ConsoleSettings = ConsoleSettings()
    engine: EngineSettings = EngineSettings()
    simulated: Simulated = Simulated()

    def __post_init__(self) -> None:
        _no_repetition("topics", [topic.signal.value for topic in self.topics])
        _no_repetition("teams", [str(team.subject) for team in self.teams])
        _no_repetition("start_poses", [pose.name for pose in self.start_poses])
        _no_repetition("evidence.topics", list(self.evidence.topics))

    def testbed_name(self, host: str) -> str:
        """The testbed's name (protocol section 2); without one in the settings, `host`."""
        return self.testbed.name or clean_name(host[:LONGEST_NAME], "host")

    def team_names(self) -> dict[int, str]:
        """Team names by subject number."""
        return {team.subject: team.name for team in self.teams}

    def usual_setup(self, setup: RunSetup) -> RunSetup:
        """`setup` with the timeout, countdown, ruleset, lock and pose of the settings."""
        pose = self.start_pose(setup.condition.starting_side)
        return replace(setup, start_pose=pose, **asdict(self.run))

    def start_pose(self, side: Side) -> StartPose:
        """The first start pose on `side`."""
        return start_pose_on(side, self.start_poses)

    def scoring_thresholds(self) -> Thresholds:
        return Thresholds(
            **asdict(self.thresholds),
            largest_skew=self.checks.largest_skew,
            rate=self.checks.rate,
        )

    def door_geometry(self) -> DoorGeometry:
        """The simulated doorway, with the masks that belong to it."""
        return self.simulated.door.geometry(self.scoring_thresholds())

    def sensor_limits(self) -> SensorLimits:
        c = self.checks
        rates = {"rate": c.rate, "least_rate": c.least_rate, "most_rate": c.most_rate}
        return SensorLimits(**asdict(self.freshness), **rates)

    def mappings(self) -> tuple[TopicMapping, ...]:
        """Topics of protocol section 3, overridden by [[topics]].

        Raises:
            MadrobError: a field path is malformed, or two signals share a topic.
        """
        settings = {topic.signal: topic for topic in self.topics}
        mappings: list[TopicMapping] = []
        for default in DEFAULT_MAPPINGS:
            setting = settings.get(default.signal, TopicSetting(signal=default.signal))
            try:
                mappings += setting.mappings(default)
            except MadrobError as error:
                where = f"settings, [[topics]] {default.signal.value}"
                raise MadrobError(f"{where}: {error}") from None
        return tuple(mappings)


def default_settings_path() -> Path:
    """Path of the settings file when none is named."""
    return user_config_path("madrob") / "madrob.toml"


def load_settings(path: Path | None = None) -> Settings:
    """Reads the settings; None reads `default_settings_path()`, which may be missing.

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
    """Parses a TOML text; MadrobError names the key and the remedy if it is not valid."""
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
