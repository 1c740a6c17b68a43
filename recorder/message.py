"""One message as it came over the wire."""

from __future__ import annotations

import msgspec


class RawMessage(msgspec.Struct, frozen=True, gc=False):
    """A serialised message; what every source yields and what a bag stores.

    Not a dataclass because there are so many: a frozen one takes ten times as long to make.

    Attributes:
        topic: full topic name, for example `/madrob/door/angle`.
        type: full type name, for example `sensor_msgs/msg/JointState`.
        data: the CDR bytes, with their 4-byte encapsulation header, untouched.
        publish_ns: when the publisher sent it, ns since the epoch.
        receive_ns: when it was received, steady time (protocol section 8), ns since the
            epoch; the bag's log time.
    """

    topic: str
    type: str
    data: bytes
    publish_ns: int
    receive_ns: int
