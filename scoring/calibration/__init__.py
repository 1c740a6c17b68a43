"""A new testbed's numbers from recordings: masks, lintel height, scale of the handle."""
