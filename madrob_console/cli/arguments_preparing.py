"""What the commands take that prepare a testbed and a machine."""

from __future__ import annotations

from pathlib import Path

from madrob_console.cli.arguments_common import Commands, Parser, add_settings_option, command
from scoring.protocol import Side

_RECORD = """\
how to record: `ros2 bag record -s mcap -o NAME --all`, or start a run, move the door and abort it:
its folder holds the recording. Topics, types and units are those of the settings."""


def add_calibrate(commands: Commands) -> None:
    """`madrob calibrate`."""
    parser = command(
        commands, "calibrate", "a new testbed's masks, lintel height and handle, from recordings"
    )
    parts = parser.add_subparsers(metavar="WHAT", required=True, parser_class=Parser)
    masks = command(
        parts,
        "masks",
        "the ten masks and the lintel height, as settings",
        "Swing the panel slowly, at about 0.2 rad/s, from closed to wide open on both sides and "
        "back, at least twice, brake off, with nobody within the sensors' reach: push it by a "
        "stick. Several recordings count together, one a side for example.",
    )
    masks.add_argument("paths", nargs="+", type=Path, metavar="PATH", help="a bag or a run folder")
    handle = command(
        parts,
        "handle",
        "zero and scale of the handle's force, as settings",
        "Record some seconds at rest, then some seconds with a known weight that pulls at the "
        "handle over a pulley, straight to one side, door blocked.",
    )
    handle.add_argument("rest", type=Path, metavar="REST", help="recording without the weight")
    handle.add_argument("weight", type=Path, metavar="WEIGHT", help="recording with the weight")
    handle.add_argument("--mass", type=float, required=True, metavar="KG", help="of the weight")
    handle.add_argument(
        "--towards",
        type=Side,
        choices=list(Side),
        default=Side.CCW,
        help="side to which the weight pulls the handle",
    )
    for part in (masks, handle):
        part.set_defaults(module="calibrate", part=part.prog.rpartition(" ")[2])
        part.epilog = _RECORD
        part.add_argument(
            "--output", type=Path, default=None, metavar="FILE", help="file for the settings"
        )
        add_settings_option(part)


def add_doctor(commands: Commands) -> None:
    """`madrob doctor`."""
    parser = command(commands, "doctor", "what is installed, found and missing")
    add_settings_option(parser)
    parser.add_argument("--domain", type=int, default=None, help="ROS domain")


def add_settings(commands: Commands) -> None:
    """`madrob settings`."""
    parser = command(
        commands,
        "settings",
        "check the settings file; print one with every default",
    )
    add_settings_option(parser)
