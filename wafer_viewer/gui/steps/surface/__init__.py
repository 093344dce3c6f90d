"""The step Surface: its sections, comparisons, and the answer to why a height is as it is."""
