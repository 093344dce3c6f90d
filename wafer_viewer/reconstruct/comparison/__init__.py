"""Comparison of two surfaces."""
