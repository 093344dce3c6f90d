"""Child processes and task runners, local or on a dask cluster; independent of wafers."""
