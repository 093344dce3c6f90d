"""Frozen data types and device protocols. No input or output."""
