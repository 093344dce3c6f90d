"""Meshes, textures and shading of height maps."""
