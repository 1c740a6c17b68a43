"""Teams and conditions compared: table, files, page; the list of teams."""
