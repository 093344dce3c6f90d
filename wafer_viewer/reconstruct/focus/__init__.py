"""Focus measures, peak search and peak interpolation."""
