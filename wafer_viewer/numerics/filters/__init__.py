"""Filters, statistics and labelling of images."""
