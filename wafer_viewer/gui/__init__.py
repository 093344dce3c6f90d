"""Browser interface: panels, scene, tiles, access."""
