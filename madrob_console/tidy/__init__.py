"""Tables for programs: one row a thing, one column a property, as csv, NDJSON or Parquet.

What result and standings look like to people is in report and standings.
"""
