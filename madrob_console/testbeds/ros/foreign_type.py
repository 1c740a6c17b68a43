"""Messages of types that are not installed here: their bytes, as they come over the wire.

rclpy wants the type support of a message class, and what is generated for a type has it. Whoever
takes bytes only needs no more of it than the type's name: that is made here, around what is
installed for an empty message. It fits Fast DDS as ROS 2 Jazzy has it.
"""

from __future__ import annotations

import ctypes
from functools import cache

from madrob_console.errors import MadrobError
from madrob_console.testbeds.ros.loading import RosObject, load_message_class, load_module

MIDDLEWARE = "rmw_fastrtps_cpp"
"""The one that it fits."""

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
    """Something that rclpy takes for the class of a message type; for raw bytes alone.

    Args:
        type_name: `pkg/msg/Type`, as the publishers say.

    Raises:
        MadrobError: the middleware is another one, or this is no name of a type.
    """
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
