"""Focus measures, the search for the peak and its interpolation."""
