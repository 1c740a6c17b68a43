"""Parts of a screen that know no run: lines, fields, tables, plots."""
