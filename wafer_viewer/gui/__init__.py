"""The browser's side: panels, scene, tiles, access."""
