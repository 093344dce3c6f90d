"""Reconstruction, stitching and comparison jobs."""
