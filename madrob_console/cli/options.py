"""The options that several commands have, and what they come to with the settings."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from madrob_console.cli.output import complain
from madrob_console.cli.parsing import (
    Parser,
    delay,
    none_of,
    number_within,
    one_of,
    whole_number,
    whole_within,
)
from madrob_console.common.errors import MadrobError
from madrob_console.common.names import Scenario, SourceKind
from madrob_console.export.table_columns import TableFormat
from madrob_console.testbeds.ros_domain import domain_number
from scoring.protocol import BenchmarkType, Condition, Side, Signal, Strip

if TYPE_CHECKING:
    from madrob_console.archive.collection import Collection
    from madrob_console.config import Settings
    from madrob_console.referee.competition_plan import Plan, PlanSource
    from madrob_console.referee.lists import TeamList, TeamSource

Commands: TypeAlias = "argparse._SubParsersAction[Parser]"

Main: TypeAlias = Callable[[argparse.Namespace], int]
"""Carries a command out and returns its exit code."""

FASTEST = 1000.0
"""Highest speed of a simulation or replay, times real time."""

_SHORT = 40
"""Longer lists of words stand in the text of an option, not beside its name."""

SIMULATION = ("scenario", "seed", "speed", "latency", "jitter")
"""Options that tell one simulated testbed from another."""

_DELAYED: dict[str, Sequence[Signal]] = {
    "all": tuple(Signal),
    "passage": tuple(map(Signal.of_strip, Strip)),
    **{signal.name.lower(): (signal,) for signal in Signal},
}
"""Names by which `--latency` and `--jitter` choose the delayed messages."""

NO_COMMAND = 1


def command(
    commands: Commands,
    name: str,
    main: Main | None,
    text: str,
    more: str = "",
    examples: Sequence[str] = (),
) -> Parser:
    """Add the parser of one command.

    `main` None = it has subcommands, and alone it prints its help. `text` is for the list of
    commands, `more` is added to the command's own help. `examples` are lines to type, with what
    each does after a `#`.
    """
    lines = ["examples:" if len(examples) > 1 else "example:", *(f"  {line}" for line in examples)]
    parser: Parser = commands.add_parser(
        name,
        help=text,
        description=f"{text[0].upper()}{text[1:]}.\n{more}".rstrip(),
        epilog="\n".join(lines) if examples else None,
    )
    parser.set_defaults(main=print_help if main is None else main)
    return parser


def print_help(arguments: argparse.Namespace) -> int:
    arguments.parser.print_help()
    return NO_COMMAND


def add_testbed(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--testbed",
        action=_Testbed,
        nargs="+",
        metavar=("ros|simulated|replay", "PATH"),
        default=None,
        help="where the data come from: `ros`, `simulated`, or `replay` and the path of a bag",
    )
    add_simulation(parser)
    parser.add_argument(
        "--speed",
        type=number_within(0, FASTEST),
        default=1.0,
        metavar="FACTOR",
        help="of a simulation or replay: 1 = real time, 0 = as fast as possible",
    )
    add_domain(parser)
    parser.add_argument(
        "--use-sim-time",
        action="store_true",
        help="follow `/clock` of a simulation over ROS, every run is practice; else setting "
        "`testbed.use_sim_time`",
    )
    add_results(parser)
    add_settings(parser)
    add_ros_args(parser)


def add_domain(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--domain",
        type=_domain,
        default=None,
        metavar="N",
        help="ROS domain; else that of the settings, else ROS_DOMAIN_ID, else 0",
    )


def add_ros_args(parser: argparse.ArgumentParser) -> None:
    """Accept the arguments that a launch file or `ros2 run` appends."""
    parser.add_argument(
        "--ros-args",
        nargs=argparse.REMAINDER,
        default=[],
        metavar="...",
        help="at the end, as of any ROS node: `-r __ns:=/hall2`, `-r FROM:=TO`, "
        "`-p use_sim_time:=true`",
    )


def _domain(text: str) -> int:
    try:
        return domain_number(text)
    except MadrobError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def ros_domain(arguments: argparse.Namespace, settings: Settings) -> int | None:
    """The ROS domain; None = `ROS_DOMAIN_ID`, or 0."""
    chosen: int | None = arguments.domain
    return settings.testbed.domain if chosen is None else chosen


class _Testbed(argparse.Action):
    """Words of a testbed: its kind, and for a replay the path of the recording."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        option_string: str | None = None,
    ) -> None:
        words = list(values or ())
        try:
            _check_testbed(words)
        except argparse.ArgumentTypeError as error:
            raise argparse.ArgumentError(self, str(error)) from None
        setattr(namespace, self.dest, words)


def _check_testbed(words: Sequence[str]) -> None:
    kind = one_of(SourceKind)(words[0])
    if kind is not SourceKind.REPLAY:
        if len(words) > 1:
            raise argparse.ArgumentTypeError(f"{kind} takes nothing more, not '{words[1]}'")
        return
    if len(words) != 2:
        raise argparse.ArgumentTypeError(f"{kind} needs the path of one bag")


def add_results(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--results",
        type=Path,
        default=None,
        metavar="FOLDER",
        help="results folder; else setting `results.folder`",
    )


def results_folder(arguments: argparse.Namespace, settings: Settings) -> Path:
    chosen: Path = getattr(arguments, "results", None) or settings.results.root  # not all take it
    return chosen.expanduser().absolute()


def add_run_paths(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "paths",
        nargs="*",
        type=Path,
        metavar="PATH",
        help="folders with runs, at any depth, each run once; else the results folder",
    )
    add_results(parser)
    parser.add_argument(
        "--testbed-name",
        metavar="NAME",
        help="only runs of the testbed of this name, as its settings call it",
    )
    add_competition(parser)


def add_competition(parser: argparse.ArgumentParser) -> None:
    """Add the choice of the competition: every competition has a team number 1."""
    parser.add_argument(
        "--competition",
        default=None,
        metavar="NAME",
        help="only runs of the competition of this name; '' = of none",
    )


def collection(arguments: argparse.Namespace, settings: Settings) -> Collection:
    """The named runs, without duplicates, of all competitions."""
    from madrob_console.archive.collection import collected, collected_in, demand_competition

    paths = run_paths(arguments, settings)
    if arguments.paths:
        found = collected(paths, arguments.testbed_name)
    else:
        found = collected_in(paths[0], arguments.testbed_name)
    if arguments.competition not in (None, settings.competition.name):
        demand_competition(arguments.competition, found.competitions)
    return found


def run_paths(arguments: argparse.Namespace, settings: Settings) -> list[Path]:
    paths: list[Path] = arguments.paths
    if paths and arguments.results is not None:
        raise MadrobError("PATH and --results: give one of the two")
    return [path.expanduser() for path in paths] or [results_folder(arguments, settings)]


def add_json(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="JSON for programs")


def add_teams(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--teams",
        type=Path,
        default=None,
        metavar="FILE",
        help="the list of teams, csv lines of subject,team; else the settings'",
    )


def team_source(arguments: argparse.Namespace, settings: Settings) -> TeamSource:
    from madrob_console.referee.lists import TeamSource

    named: Path | None = arguments.teams
    if named is None:
        return TeamSource(settings.team_names(), settings.competition.teams_path)
    return TeamSource(settings.team_names(), named.expanduser().absolute(), "correct --teams")


def team_list(arguments: argparse.Namespace, settings: Settings) -> TeamList:
    """The list of teams, its bad lines named; a file that only the settings name may be missing."""
    from madrob_console.referee.lists import read_teams

    source = team_source(arguments, settings)
    if arguments.teams is not None and source.file is not None:
        read_teams(source.file, source.remedy)
    listed = source.read()
    tell_problems(listed)
    return listed


def plan_list(arguments: argparse.Namespace, settings: Settings) -> Plan:
    """The plan, its bad lines named; a file that only the settings name may be missing."""
    from madrob_console.referee.competition_plan import read_plan

    source = plan_source(arguments, settings)
    if arguments.plan is not None and source.file is not None:
        read_plan(source.file, source.remedy)
    plan = source.read()
    tell_problems(plan)
    return plan


def tell_problems(listed: TeamList | Plan) -> None:
    """Name the bad lines of a list."""
    for problem in listed.problems:
        complain(problem)


def team_names(
    arguments: argparse.Namespace, settings: Settings, found: Collection
) -> Mapping[int, str]:
    """The list of teams for these runs; that of the settings holds for their competition only."""
    own, chosen = settings.competition.name, arguments.competition
    of = found.competitions if chosen is None else {chosen}
    if arguments.teams is None and own and of and own not in of:
        return {}
    return team_list(arguments, settings).names


def add_plan(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--plan",
        type=Path,
        default=None,
        metavar="FILE",
        help="the competition's plan, csv lines of subject,condition,attempts,time; else the "
        "settings'",
    )


def plan_source(arguments: argparse.Namespace, settings: Settings) -> PlanSource:
    from madrob_console.referee.competition_plan import PlanSource

    named: Path | None = arguments.plan
    if named is None:
        return settings.plan.source
    return PlanSource((), named.expanduser().absolute(), "correct --plan")


def add_settings(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--settings",
        type=Path,
        default=None,
        metavar="FILE",
        help="settings file (TOML); else ~/.config/madrob/madrob.toml",
    )


def add_idle_time(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--idle-time",
        type=number_within(0),
        default=None,
        metavar="S",
        help="s without a screen and without a run after which the engine ends; else setting "
        "`engine.idle_time`, at most 20 where simulated",
    )


def add_format(
    parser: argparse.ArgumentParser, default: TableFormat | None = TableFormat.CSV
) -> None:
    add_choice(
        parser,
        "--format",
        TableFormat,
        default,
        "csv, ndjson (a JSON object on each line) or parquet, which needs the extra `tables`",
    )


def add_jobs(parser: argparse.ArgumentParser, done: str) -> None:
    parser.add_argument(
        "--jobs",
        type=whole_within(1),
        default=None,
        metavar="N",
        help=f"runs {done} at once; as many as there are cores if not given",
    )


run_number = whole_within(1, 999)
"""Argument type of a subject or a run: file names have three digits for them."""


def add_subject(
    parser: argparse.ArgumentParser, default: int | None = None, *, needed: bool = True
) -> None:
    """Add the team, by its subject number (protocol section 1); `--team` means the same."""
    either = parser.add_mutually_exclusive_group(required=needed and default is None)
    for flag, text in (("--subject", "the team's number"), ("--team", argparse.SUPPRESS)):
        either.add_argument(
            flag, dest="subject", type=run_number, default=default, metavar="N", help=text
        )


def add_simulation(parser: argparse.ArgumentParser) -> None:
    add_choice(parser, "--scenario", Scenario, Scenario.NOMINAL, "what the simulated robot does")
    parser.add_argument(
        "--seed", type=whole_number, default=0, metavar="N", help="of the simulation"
    )
    which = f"`50ms` or `door=50ms,passage=0.1s`; signals: {', '.join(_DELAYED)}"
    for flag, text in (
        ("--latency", f"simulated messages arrive so much later: {which}"),
        ("--jitter", "standard deviation of a random delay beside the latency, likewise"),
    ):
        parser.add_argument(flag, type=_delay_text, metavar="SIGNAL=TIME,...", help=text)


def _delay_text(text: str) -> str:
    delays(text)
    return text


def delays(text: str | None) -> Mapping[Signal, float]:
    """The delays that `--latency` or `--jitter` names, s; later ones replace earlier ones."""
    found = dict[Signal, float]()
    for part in () if text is None else text.split(","):
        name, _, time = part.rpartition("=")
        if (signals := _DELAYED.get(name or "all")) is None:
            raise argparse.ArgumentTypeError(none_of(name, _DELAYED))
        found |= dict.fromkeys(signals, delay(time))
    return found


def add_condition(parser: argparse.ArgumentParser) -> None:
    """Add the condition, in its three parts (protocol section 1)."""
    add_choice(parser, "--opening-side", Side, Side.CCW, "side towards which the door may open")
    add_choice(parser, "--starting-side", Side, Side.CCW, "side on which the robot starts")
    add_choice(
        parser,
        "--benchmark-type",
        BenchmarkType,
        BenchmarkType.NO_FORCE,
        "force with which the door is braked",
    )


def add_choice(
    parser: argparse.ArgumentParser,
    flag: str,
    words: type[StrEnum],
    default: StrEnum | None,
    text: str,
) -> None:
    metavar = None
    if len(listed := ", ".join(words)) > _SHORT:
        metavar = flag.rpartition("-")[2].upper()
        text = f"{text}: {listed}"
    parser.add_argument(
        flag,
        type=one_of(words),
        choices=list(words),
        default=default,
        metavar=metavar,
        help=text,
    )


def condition_of(arguments: argparse.Namespace) -> Condition:
    return Condition(arguments.benchmark_type, arguments.opening_side, arguments.starting_side)
