"""Which key does what, and what it asks before.

What an act needs and whether it is possible is in referee.
"""
