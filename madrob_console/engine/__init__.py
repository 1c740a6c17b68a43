"""RECORD, DETECT, SCORE: the run that goes on, in a process that any number of screens share.

Runs that are over are in archive; what a referee may do when is in referee.
"""
