"""Camera presets, frustum and animated transitions."""
