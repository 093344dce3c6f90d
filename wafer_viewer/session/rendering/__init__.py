"""The render process: tiles, thumbnails and statistics of surfaces."""
