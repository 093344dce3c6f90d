"""Samples, faces, fits and uncertainty shared by the measuring tools."""
