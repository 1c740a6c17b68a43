"""An example of the settings file, with every setting and its default."""

from __future__ import annotations

import json
from collections.abc import Iterator
from enum import Enum

import msgspec
from msgspec import inspect

from madrob_console.config.setting_types import description, fields, plain
from madrob_console.config.settings import Settings
from scoring.protocol import Signal

_LISTS_HELP = """\
# The teams, by subject number. One that stands here counts, whatever the teams file says. A change
# here counts from the engine's next start on; the teams file is read again whenever it changes.
#[[teams]]
#subject = 3
#name = "Team Walker"

# Start poses to choose from, in the frame madrob_door: x in m towards the CCW side, y in m along
# the wall, yaw in degrees.
#[[start_poses]]
#name = "CCW, close"
#x = 1.0
#y = 0.0
#yaw = 180.0

# How a testbed publishes a signal, where it differs from the protocol: one [[topics]] for each.
# What is left out stays as the protocol has it. A value is field * scale + offset, in rad, N or m,
# or in the `unit`: deg; gf, kgf; mm, cm. A strip may be four `topics` of one range each.
# A field is a path: wrench.force.x, position[0], position[name=door], ranges.range of each message.
# A message of more than `largest` bytes is recorded but not read; by default 65536.
# The signals are
{signals}
#[[topics]]
#signal = "handle force"
#topic = "/madrob/handle"
#type = "madrob_msgs/msg/Handle"
#field = "force"
#scale = 1.0
#offset = 0.0
#unit = "gf"
#largest = 400"""


def example_toml() -> str:
    """A settings file with every setting, its meaning and its default, all commented out."""
    lines = ["# Settings of the MADROB console. Lines that begin with # show the defaults.", ""]
    lines += _tables("", Settings())
    help_text = _LISTS_HELP.format(signals="\n".join(f"#   {s.value}" for s in Signal))
    return "\n".join([*lines, help_text])


def _tables(name: str, table: msgspec.Struct) -> Iterator[str]:
    inner = []
    described = []
    for field in fields(inspect.type_info(type(table))):
        value = getattr(table, field.name)
        if isinstance(value, msgspec.Struct):
            inner.append((f"{name}.{field.encode_name}".lstrip("."), value))
        elif not _tables_in(plain(field.type)):
            shown = "..." if value is None else toml_value(value)
            described.append(f"#{field.encode_name} = {shown}  # {description(field.type)}")
    if described:
        yield from (f"[{name}]", *described, "")
    for inner_name, inner_table in inner:
        yield from _tables(inner_name, inner_table)


def _tables_in(kind: inspect.Type) -> bool:
    """Whether it is a list of tables, which the example explains at its end."""
    return isinstance(kind, inspect.VarTupleType) and isinstance(kind.item_type, inspect.StructType)


def toml_value(value: object) -> str:
    """A text, a number, a choice or a list of them as TOML."""
    if isinstance(value, Enum):
        value = value.value
    return json.dumps(value, ensure_ascii=False)
