"""Threads, processes and sockets around the engine.

Nothing of a run is decided here.
"""
