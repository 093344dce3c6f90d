"""Child processes and task runners, local or on a dask cluster. Knows no wafer."""
