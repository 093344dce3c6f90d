"""Correction of frames before the focus measure is computed."""
