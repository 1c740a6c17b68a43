"""`madrob testbed`: the simulated testbed as a ROS 2 node."""

from __future__ import annotations

import argparse
from functools import partial

from madrob_console.cli import option_values, options
from madrob_console.cli.command_line import Argument, command
from madrob_console.cli.parsing import whole_within


@command(
    "testbed",
    "the simulated testbed as a ROS 2 node",
    "The robot sets out when /madrob/referee/state says that the run is running.",
    options=(
        *options.SIMULATED,
        *options.CONDITION,
        options.DOMAIN,
        Argument(
            "--repeat",
            type=whole_within(0),
            default=1,
            metavar="N",
            help="runs before it ends; 0 = no end",
        ),
        options.SETTINGS,
        options.ROS_ARGS,
    ),
    examples=("madrob testbed --scenario slam --repeat 0  # beside: madrob console --testbed ros",),
)
def testbed(arguments: argparse.Namespace) -> int:
    from madrob_console.cli.session import simulated_testbed
    from madrob_console.config import load_settings
    from madrob_console.testbeds.simulated_node import serve_testbed

    settings = load_settings(arguments.settings)
    serve_testbed(
        simulated_testbed(arguments, settings),
        option_values.condition_of(arguments),
        arguments.repeat,
        say=partial(print, flush=True),
        domain=option_values.ros_domain(arguments, settings),
        mappings=settings.mappings(),
        ros_args=arguments.ros_args,
    )
    return 0
