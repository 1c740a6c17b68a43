from __future__ import annotations

import socket

from madrob_console.engine.process.evidence_messages import FinishFile, LeaveDisk, ListenFor
from madrob_console.engine.process.evidence_program import OrderLine
from madrob_console.engine.shown.wire import frame
from madrob_console.testbeds.evidence_choice import EvidenceChoice


def test_an_order_that_comes_together_with_the_first_one_is_carried_out_too() -> None:
    listen = ListenFor(7, EvidenceChoice(("/camera/**",)), (), ())
    orders = listen, FinishFile(1), LeaveDisk(held=True)
    engine, process = socket.socketpair()
    with engine, process:
        engine.sendall(b"".join(map(frame, orders)))
        line = OrderLine(process)
        assert line.first_order() == listen
        assert line.orders() == [FinishFile(1), LeaveDisk(held=True)]
