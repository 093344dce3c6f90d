"""Surfaces in the formats of other programs, a file for each: how it is written strip by strip, and how it is read."""
