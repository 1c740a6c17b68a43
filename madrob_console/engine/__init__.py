"""RECORD, DETECT, SCORE: the run that goes on, in a process that any number of screens share."""
