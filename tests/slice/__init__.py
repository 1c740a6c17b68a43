"""A run through one asyncio program: the design that the engine's rewrite is decided by.

It joins rclpy's take loop, the recorder, today's run, acts and detector, a socket and a scoring
child in one event loop. `python -m tests.slice --help` starts it; `trials.py` tries it. Read
`engine.py` first: it starts everything.
"""
