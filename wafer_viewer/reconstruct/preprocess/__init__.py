"""Correction of frames before focus is measured."""
