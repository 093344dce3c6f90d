"""Tables and wafer maps for other programs: CSV, KLARF, SEMI E142, SINF, training sets."""
