"""Bytes in, MCAP out.

What the bytes mean is in madrob_console; no ROS is needed to read or write them.
"""
