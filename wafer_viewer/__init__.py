"""Wafer Viewer: shape from focus over whole wafers, from the scan to the measured surface."""

__version__ = "0.1.0"
