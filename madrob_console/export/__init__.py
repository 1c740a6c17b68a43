"""All runs of a team in one zip, with what is needed to read it."""
