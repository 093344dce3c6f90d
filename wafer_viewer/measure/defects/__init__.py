"""Inspection of patterned wafers: scores, segmentation, classification."""
