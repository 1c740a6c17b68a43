"""Pages for people: the report of a run, standings, and a competition's site."""
