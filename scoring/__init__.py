"""Numbers in, scores out.

The rules are in `PROTOCOL.md` beside this file. No ROS, no terminal, no bags; of files only
EUROBENCH's.
"""
