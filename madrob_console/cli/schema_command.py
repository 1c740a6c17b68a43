"""`madrob schema`: what `result.json` and the lines of `madrob watch --json` hold, for programs."""

from __future__ import annotations

import argparse
from enum import StrEnum

from madrob_console.cli.command_line import Argument, command
from madrob_console.cli.parsing import one_of


class Described(StrEnum):
    """What a schema describes."""

    RESULT = "result"
    STATE = "state"


@command(
    "schema",
    "the JSON schema of a result, or of `madrob watch --json`",
    options=(
        Argument(
            "what",
            nargs="?",
            type=one_of(Described),
            choices=list(Described),
            default=Described.RESULT,
            help="result.json, if not given",
        ),
    ),
    examples=("madrob schema > result_schema.json", "madrob schema state > state_schema.json"),
)
def schema(arguments: argparse.Namespace) -> int:
    from madrob_console.archive.result_document import result_schema, schema_text
    from madrob_console.engine.public_state import state_schema

    told = state_schema() if arguments.what is Described.STATE else result_schema()
    print(schema_text(told).decode(), end="")
    return 0
