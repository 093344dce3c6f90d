"""Atomic files, checksums and logs."""
