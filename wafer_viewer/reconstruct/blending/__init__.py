"""Blending of placed fields into one surface."""
