"""Plane of a file that holds one image: PNG, JPEG, BMP, PGM, WebP."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from wafer_viewer.model.acquisition.image_source import ImagePlane
from wafer_viewer.store.images.image_files import read_file, states_simulated, texts_of_image


def planes_of_image(path: Path) -> tuple[ImagePlane, ...]:
    """Return the one plane of an image file."""
    simulated = states_simulated(texts_of_image(path))
    return (ImagePlane(path.name, path, 0, partial(read_file, path), simulated=simulated),)
