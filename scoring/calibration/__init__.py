"""A new testbed's numbers from recordings: masks, lintel height, scale of the handle.

Bags are read, and settings printed, by madrob_console.
"""
