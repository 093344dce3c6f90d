"""Tables and wafer maps for other programs: CSV, KLARF, training sets."""
