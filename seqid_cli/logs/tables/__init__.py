"""Tables: CSV and Parquet, one row per sample."""
