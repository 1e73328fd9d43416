"""Tables of results: one row a record, as Parquet, SQLite, CSV or JSON lines."""
