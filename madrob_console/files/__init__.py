"""Files that may be hostile: read bounded and without links, written whole or not at all.

What a file means is said where it belongs (archive, config, standings).
"""
