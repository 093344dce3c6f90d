"""Validity tests of focus peaks."""
