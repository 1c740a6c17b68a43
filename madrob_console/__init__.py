"""The referee console of the MADROB robot-door benchmark: source, record, detect, score, show.

`ARCHITECTURE.md` beside this file draws the flow and says why things are as they are.
"""
