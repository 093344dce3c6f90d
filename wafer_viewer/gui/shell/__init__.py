"""Page assembly: layout, shortcuts, palette, maps."""
