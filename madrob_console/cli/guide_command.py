"""`madrob guide`: the pages of the guide in the terminal."""

from __future__ import annotations

import argparse
import sys
from importlib import resources

from madrob_console.cli.command_line import Argument, command
from madrob_console.cli.safe_stream import raw

PAGES = {
    "referee": "a run from set-up to signature, keys, protests, words",
    "testbed": "topics, settings, cameras, engine, service, security",
    "robots": "what the referee publishes over ROS",
    "data": "files, tables, scoring again, several testbeds",
    "library": "scoring arrays, tables, figures and bags from Python",
    "organiser": "teams, plan, standings, web pages, zips",
}
"""The pages and their subjects; they lie in the folder `guide` of the package."""


@command(
    "guide",
    "the guide, a page for each role",
    "Without PAGE it lists the pages.",
    options=(
        Argument("page", nargs="?", choices=list(PAGES), metavar="PAGE", help=", ".join(PAGES)),
    ),
    examples=("madrob guide", "madrob guide referee", "madrob guide data > data.md"),
)
def guide(arguments: argparse.Namespace) -> int:
    """Print a page (with layout on a terminal), or the list of pages."""
    from rich.console import Console
    from rich.markdown import Markdown

    if arguments.page is None:
        for page, about in PAGES.items():
            print(f"madrob guide {page:9}  {about}")
        return 0
    source = resources.files("madrob_console") / "guide" / f"{arguments.page}.md"
    text = source.read_text(encoding="utf-8")
    console = Console(file=raw(sys.stdout))
    if console.is_terminal and console.encoding == "utf-8":
        console.print(Markdown(text, code_theme="ansi_dark", hyperlinks=False))
    else:
        print(text, end="")
    return 0
