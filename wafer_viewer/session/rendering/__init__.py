"""Render process: tiles, thumbnails and statistics of surfaces."""
