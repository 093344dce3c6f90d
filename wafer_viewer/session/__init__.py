"""Operator session: state, commands and background work."""
