"""Teams and conditions compared: table, files, page.

Which runs there are is asked of archive; the screen with them is in ui.
"""
