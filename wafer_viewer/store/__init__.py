"""Persistence: datasets, journals, mosaics, and file import and export."""
