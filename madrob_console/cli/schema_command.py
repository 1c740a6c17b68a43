"""`madrob schema`: the JSON schemas of what programs read."""

from __future__ import annotations

import argparse
from enum import StrEnum

from madrob_console.cli.command_line import Argument, command
from madrob_console.cli.parsing import one_of


class Described(StrEnum):
    """What a schema describes."""

    RESULT = "result"
    EVENT = "event"
    STATE = "state"
    WATCH = "watch"


@command(
    "schema",
    "the JSON schema of a result, or of the referee's messages",
    "The events and states are those of /madrob/referee/event and /madrob/referee/state.",
    options=(
        Argument(
            "what",
            nargs="?",
            type=one_of(Described),
            choices=list(Described),
            default=Described.RESULT,
            help="result.json, if not given; `watch` is a line of `madrob watch --json`",
        ),
    ),
    examples=("madrob schema > result_schema.json", "madrob schema event > event_schema.json"),
)
def schema(arguments: argparse.Namespace) -> int:
    from madrob_console.archive.result_document import result_schema, schema_text
    from madrob_console.engine.public_state import state_schemas

    schemas = {"result": result_schema(), **state_schemas()}
    print(schema_text(schemas[arguments.what]).decode(), end="")
    return 0
