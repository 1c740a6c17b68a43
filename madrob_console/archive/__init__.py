"""RUNS ON DISK: folders, results, history, unfinished runs, scoring again, checking.

What goes on now is in engine; what teams take home is in report, export and standings.
"""
