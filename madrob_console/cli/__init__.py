"""The commands, one file each (`<name>_command.py`), and what several of them share.

What is done to runs, settings and testbeds is in the rooms below.
"""
