"""The page assembled: layout, shortcuts, palette, maps."""
