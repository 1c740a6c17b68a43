"""Teams and conditions compared: table, files, page; the list of teams.

Which runs there are is asked of archive; the screen with them is in ui.
"""
