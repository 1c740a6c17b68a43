"""What is handed out: all runs of a team in one zip, and tables for programs.

The files themselves are made by archive and pages.
"""
