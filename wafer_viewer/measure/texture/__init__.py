"""Areal texture and profile roughness."""
