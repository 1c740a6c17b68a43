"""`madrob schema`: what `result.json` holds, for programs."""

from __future__ import annotations

import argparse

from madrob_console.cli import options


def add_command(commands: options.Commands) -> None:
    options.command(
        commands,
        "schema",
        main,
        "the JSON schema of result.json",
        examples=("madrob schema > result_schema.json",),
    )


def main(_arguments: argparse.Namespace) -> int:
    from madrob_console.archive.result_document import schema_text

    print(schema_text().decode(), end="")
    return 0
