"""`madrob schema`: what `result.json` holds, for programs."""

from __future__ import annotations

import argparse

from madrob_console.archive.result_document import schema_text


def main(_arguments: argparse.Namespace) -> int:
    """Print the JSON schema."""
    print(schema_text().decode(), end="")
    return 0
