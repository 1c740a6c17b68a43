"""EUROBENCH's files: folder and file names, csv, YAML, the published scripts' own data."""
