"""Report of a dataset."""
