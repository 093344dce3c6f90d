"""Reconstruction of height maps and mosaics from focus stacks, without side effects."""
