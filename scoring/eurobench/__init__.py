"""EUROBENCH's files: folder and file names, csv, YAML, the published scripts' own data.

How those scripts compute is a ruleset, beside the protocol's.
"""
