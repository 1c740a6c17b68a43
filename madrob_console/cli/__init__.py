"""The commands, one file each (`<name>_command.py`), and what several of them share."""
