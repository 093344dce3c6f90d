"""Frozen state that the page reads."""
