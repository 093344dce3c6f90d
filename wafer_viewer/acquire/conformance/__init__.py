"""Conformance checks: what a rig has to do for a scan, measured on the rig itself."""
