"""Defect inspection of the session."""
