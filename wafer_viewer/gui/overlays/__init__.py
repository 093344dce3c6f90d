"""Legends and tools that float over the scene."""
