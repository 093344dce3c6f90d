"""Focus: search at a place, coarse look over the sample, prediction, and windows that follow it."""
