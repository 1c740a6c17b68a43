"""`madrob testbed`: the simulated testbed as a ROS 2 node."""

from __future__ import annotations

import argparse
from functools import partial

from madrob_console.cli.session import simulated_testbed
from madrob_console.config import load_settings
from madrob_console.testbeds.simulated_node import serve_testbed
from scoring.protocol import Condition


def main(arguments: argparse.Namespace) -> int:
    """Be a testbed until its runs are over."""
    settings = load_settings(arguments.settings)
    condition = Condition(arguments.benchmark_type, arguments.opening_side, arguments.starting_side)
    serve_testbed(
        simulated_testbed(arguments, settings),
        condition,
        arguments.repeat,
        say=partial(print, flush=True),
        domain=arguments.domain if arguments.domain is not None else settings.testbed.domain,
        mappings=settings.mappings(),
    )
    return 0
