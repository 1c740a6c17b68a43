"""All runs of a team in one zip, with what is needed to read it.

The files themselves are made by archive and report.
"""
