"""One run after the other: records, follows, decides, scores, in one thread.

Sockets and processes are in process; what screens see is in shown.
"""
