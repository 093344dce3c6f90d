"""Rendering as pure functions: maps to images, curves to SVG, surfaces to GLB tiles; for page and reports."""
