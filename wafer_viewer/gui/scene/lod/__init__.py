"""Level of detail: quadtree, tiles and their caches."""
