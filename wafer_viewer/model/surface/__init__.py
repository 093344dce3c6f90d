"""Height maps, recipes, poses and comparisons."""
