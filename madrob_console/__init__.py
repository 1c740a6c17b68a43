"""The referee console of the MADROB robot-door benchmark: source, record, detect, score, show."""
