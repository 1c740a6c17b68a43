"""Message types of the running ROS system, installed here or not."""

from __future__ import annotations

import ctypes
import json
import os
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from rosbags.interfaces import Nodetype
from rosbags.typesys import TypesysError, get_types_from_msg

from madrob_console.common.errors import MadrobError
from madrob_console.testbeds.ros.connection import RosObject, load_message_class, load_module

_SEPARATOR = "=" * 80


@dataclass(frozen=True, slots=True)
class Definition:
    """A type's `ros2msg` text with nested definitions appended; an unknown hash is empty."""

    text: str
    type_hash: str


def prefixes(environment: Mapping[str, str]) -> tuple[Path, ...]:
    """Where packages are installed: `AMENT_PREFIX_PATH`, or Python's own prefix (the wheels)."""
    paths = environment.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return tuple(Path(path) for path in paths if path) or (Path(sys.prefix),)


def find_definition(type_name: str, prefixes: Sequence[Path]) -> Definition | None:
    """The installed definition of a type; None without its `.msg` file."""
    text = _msg_text(type_name, prefixes)
    if text is None:
        return None
    found: dict[str, str] = {}
    known, pending = {type_name}, _nested(type_name, text)
    while pending:
        nested = pending.pop(0)
        if nested in known:
            continue
        known.add(nested)
        inner = _msg_text(nested, prefixes)
        if inner is not None:
            found[nested] = inner
            pending += _nested(nested, inner)
    return Definition(joined(text, found), _type_hash(type_name, prefixes))


def joined(text: str, nested: Mapping[str, str]) -> str:
    parts = [text]
    for name, inner in nested.items():
        package, last = name.split("/")[0], name.split("/")[-1]
        parts.append(f"{_SEPARATOR}\nMSG: {package}/{last}\n{inner}")
    return "\n".join(parts)


def _file(type_name: str, suffix: str, prefixes: Sequence[Path]) -> Path | None:
    package, name = type_name.split("/", maxsplit=1)[0], type_name.rsplit("/", maxsplit=1)[-1]
    for prefix in prefixes:
        path = prefix / "share" / package / "msg" / f"{name}{suffix}"
        if path.is_file():
            return path
    return None


def _msg_text(type_name: str, prefixes: Sequence[Path]) -> str | None:
    path = _file(type_name, ".msg", prefixes)
    return path.read_text(encoding="utf-8", errors="replace") if path else None


def _type_hash(type_name: str, prefixes: Sequence[Path]) -> str:
    path = _file(type_name, ".json", prefixes)
    try:
        hashes = json.loads(path.read_bytes())["type_hashes"] if path else []
        return next((str(h["hash_string"]) for h in hashes if h["type_name"] == type_name), "")
    except (OSError, ValueError, LookupError, TypeError):
        return ""


def _nested(type_name: str, text: str) -> list[str]:
    try:
        fields = get_types_from_msg(text, type_name)[type_name][1]
    except (TypesysError, ValueError, LookupError):
        return []
    inner = [f[1][0] if f[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else f for _, f in fields]
    return [f[1] for f in inner if f[0] == Nodetype.NAME]


# Raw bytes of types that are not installed here.
#
# rclpy wants the type support of a message class. Whoever takes bytes needs only the type's name,
# so a support is made here around that of an empty message. It fits Fast DDS as ROS 2 Jazzy has
# it.


MIDDLEWARE = "rmw_fastrtps_cpp"
"""The only middleware that `foreign_class` works with."""

_FAST = b"rosidl_typesupport_fastrtps_c"
_FIELDS = b"rosidl_typesupport_introspection_c"
_KNOWN = "std_msgs/msg/Empty"
_CLASS_ATTRIBUTES = (
    *("_CREATE_ROS_MESSAGE", "_CONVERT_FROM_PY", "_CONVERT_TO_PY", "_DESTROY_ROS_MESSAGE"),
)

_Find = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)
_LargestSize = ctypes.CFUNCTYPE(ctypes.c_size_t, ctypes.POINTER(ctypes.c_char))


class _Support(ctypes.Structure):
    """`rosidl_message_type_support_t`."""

    _fields_ = (
        ("identifier", ctypes.c_char_p),
        ("data", ctypes.c_void_p),
        ("find", ctypes.c_void_p),
        ("type_hash", ctypes.c_void_p),
        ("description", ctypes.c_void_p),
        ("sources", ctypes.c_void_p),
    )


class _Callbacks(ctypes.Structure):
    """`message_type_support_callbacks_t`."""

    _fields_ = (
        ("namespace", ctypes.c_char_p),
        ("name", ctypes.c_char_p),
        ("serialize", ctypes.c_void_p),
        ("deserialize", ctypes.c_void_p),
        ("size", ctypes.c_void_p),
        ("largest_size", ctypes.c_void_p),
        ("key", ctypes.c_void_p),
    )


@cache
def foreign_class(type_name: str) -> RosObject:
    """A stand-in for a message class, for raw bytes alone; it needs `MIDDLEWARE`."""
    rclpy = load_module("rclpy.impl.implementation_singleton").rclpy_implementation
    package, _, rest = type_name.partition("/")
    kind, _, name = rest.partition("/")
    plain = all(part.isascii() and part.isidentifier() for part in (package, kind, name))
    if not plain or rclpy.rclpy_get_rmw_implementation_identifier() != MIDDLEWARE:
        raise MadrobError(f"{type_name} is not installed here: source the workspace that has it")
    known_class = load_message_class(_KNOWN).__class__
    if known_class._TYPE_SUPPORT is None:
        known_class.__import_type_support__()
    known = _support_at(_pointer(known_class._TYPE_SUPPORT))
    find_known = _Find(known.find)
    fast = find_known(ctypes.addressof(known), _FAST)
    fields = find_known(ctypes.addressof(known), _FIELDS)
    if not fast or not fields:
        raise MadrobError(f"{type_name} is not installed here: source the workspace that has it")
    pattern = _support_at(fast)
    callbacks = ctypes.cast(pattern.data, ctypes.POINTER(_Callbacks)).contents
    largest_size = _LargestSize(_unbounded)
    own_callbacks = _Callbacks(
        f"{package}::{kind}".encode(),
        name.encode(),
        callbacks.serialize,
        callbacks.deserialize,
        callbacks.size,
        ctypes.cast(largest_size, ctypes.c_void_p),
        None,
    )
    support = _Support(
        _FAST,
        ctypes.addressof(own_callbacks),
        None,
        pattern.type_hash,
        pattern.description,
        pattern.sources,
    )
    found = {_FAST: ctypes.addressof(support), _FIELDS: fields}
    find = _Find(lambda _handle, identifier: found.get(identifier))
    support.find = ctypes.cast(find, ctypes.c_void_p)
    capsule = ctypes.pythonapi.PyCapsule_New
    capsule.restype = ctypes.py_object
    capsule.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p]
    given = {attribute: getattr(known_class, attribute) for attribute in _CLASS_ATTRIBUTES}
    given["_TYPE_SUPPORT"] = capsule(ctypes.addressof(support), None, None)
    # ROS keeps pointers to it: as long as the class, which is kept for good
    given["_kept"] = (own_callbacks, support, largest_size, find)
    return type("ForeignType", (type,), given)(name, (), {})


def _unbounded(bounds: RosObject) -> int:
    bounds[0] = b"\x00"
    return 1


def _pointer(capsule: RosObject) -> int:
    pointer = ctypes.pythonapi.PyCapsule_GetPointer
    pointer.restype = ctypes.c_void_p
    pointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
    return int(pointer(capsule, None))


def _support_at(address: int) -> _Support:
    return ctypes.cast(address, ctypes.POINTER(_Support)).contents


# Definitions of a topic's messages, from this system or from its publisher.


PATIENCE = 2.0
"""Seconds that a publisher's node has to send the definition of its type."""

_SERVICE = "type_description_interfaces.srv"
_LARGEST = 256_000
"""The most characters of a definition."""


@dataclass(slots=True)
class _Asked:
    client: RosObject  # None = nobody yet, for who publishes it has no name
    until: float
    future: RosObject = None


class TypeWords:
    """Finds definitions of message types: installed ones, else those of a publisher's node.

    `node` must be spun while `pending`. One thread.
    """

    def __init__(self, node: RosObject, prefixes: Sequence[Path]) -> None:
        self._node = node
        self._prefixes = prefixes
        self._installed: dict[str, Definition | None] = {}
        self._told: dict[tuple[str, str], Definition] = {}
        self._asked: dict[tuple[str, str], _Asked] = {}

    @property
    def pending(self) -> bool:
        return bool(self._asked)

    def find(self, type_name: str, type_hash: str, who: str) -> Definition | None:
        """The definition of a type, without text where no node has it; None = ask again later.

        `who` is the full name of a node that publishes the type; empty = not known.
        """
        if type_name not in self._installed:
            self._installed[type_name] = find_definition(type_name, self._prefixes)
        installed = self._installed[type_name]
        if installed is not None and installed.type_hash in (type_hash, ""):
            return installed
        if installed is not None and not type_hash:
            return installed
        key = (type_name, type_hash)
        if key in self._told:
            return self._told[key]
        if key not in self._asked or (who and self._asked[key].client is None):
            self._ask(key, who)
        if key in self._asked and not self._answered(key, self._asked[key]):
            return None
        return self._told[key]

    def _ask(self, key: tuple[str, str], who: str) -> None:
        try:
            service = load_module(_SERVICE).GetTypeDescription
        except ModuleNotFoundError:
            self._told[key] = Definition("", key[1])
            return
        client = None
        if who:
            client = self._node.create_client(service, f"{who}/get_type_description")
        self._asked[key] = _Asked(client, time.monotonic() + PATIENCE)

    def _answered(self, key: tuple[str, str], asked: _Asked) -> bool:
        client = asked.client
        if client is not None and asked.future is None and client.service_is_ready():
            kind = client.srv_type
            request = kind.Request(type_name=key[0], type_hash=key[1], include_type_sources=True)
            asked.future = client.call_async(request)
        done = asked.future is not None and asked.future.done()
        if not done and time.monotonic() < asked.until:
            return False
        del self._asked[key]
        answer = asked.future.result() if done else None
        if client is not None:
            self._node.destroy_client(client)
        text = "" if answer is None or not answer.successful else _text(key[0], answer.type_sources)
        self._told[key] = Definition(text, key[1])
        return True


def _text(type_name: str, sources: Iterable[RosObject]) -> str:
    told = {str(each.type_name): each for each in sources}
    if type_name not in told or any(each.encoding != "msg" for each in told.values()):
        return ""
    own = str(told.pop(type_name).raw_file_contents)
    text = joined(own, {name: str(each.raw_file_contents) for name, each in told.items()})
    return text if len(text) <= _LARGEST else ""
