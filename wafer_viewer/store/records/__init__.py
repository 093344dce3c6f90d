"""Files of calibrations, gauge checks, recipes and reports."""
