"""Rig process, its client and the scan."""
