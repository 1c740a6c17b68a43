"""`madrob testbed`: the simulated testbed as a ROS 2 node."""

from __future__ import annotations

import argparse
from functools import partial

from madrob_console.cli.arguments import (
    Commands,
    add_condition_options,
    add_domain_option,
    add_scenario_options,
    add_settings_option,
    command,
    condition_of,
    ros_domain,
)
from scoring.imports import imports_kept


def add(commands: Commands) -> None:
    """Its command line."""
    parser = command(
        commands,
        "testbed",
        main,
        "the simulated testbed as a ROS 2 node",
        "The robot sets out when /madrob/referee/state says that the run is running.",
    )
    add_scenario_options(parser)
    add_condition_options(parser)
    add_domain_option(parser)
    parser.add_argument("--repeat", type=int, default=1, help="runs before it ends; 0 = no end")
    add_settings_option(parser)


def main(arguments: argparse.Namespace) -> int:
    """Be a testbed until its runs are over."""
    with imports_kept():
        from madrob_console.cli.session import simulated_testbed
        from madrob_console.config import load_settings
        from madrob_console.testbeds.simulated_node import serve_testbed

    settings = load_settings(arguments.settings)
    serve_testbed(
        simulated_testbed(arguments, settings),
        condition_of(arguments),
        arguments.repeat,
        say=partial(print, flush=True),
        domain=ros_domain(arguments, settings),
        mappings=settings.mappings(),
    )
    return 0
