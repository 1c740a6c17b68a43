"""What is handed out: all runs of a team, or one run as a dossier, in one zip.

The files themselves are made by archive and pages.
"""
