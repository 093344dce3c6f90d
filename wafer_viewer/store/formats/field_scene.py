"""Fields of a stitched surface as images of their own, placed by their poses: an OME-NGFF 0.6 scene.

Other programs stitch, show or judge the fields themselves. Each field is an image of two channels, the all-in-focus
picture and the heights without the field's own offset and tilt. The scene has two coordinate systems: *stitched* holds
the solved positions and is what a viewer shows, *stage* those that the stage gave.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import Progress, ShouldStop, with_progress
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.store.formats.reader_support import caveats
from wafer_viewer.store.io.atomic_files import atomic_write, require_free
from wafer_viewer.store.mosaic.zarr_shards import COARSEST_PX, NGFF_SCENE_VERSION, OWN, SURFACE

if TYPE_CHECKING:
    import zarr

ENDING = ".zarr"
"""Ending of a scene; ``.ome.zarr`` by convention."""
CHANNELS = ("all_in_focus", "z_um")
FIELD, STITCHED, STAGE = "field", "stitched", "stage"
"""Coordinate systems: of an image, of the solved poses, and of the positions by the stage."""
_UM = {"type": "space", "unit": "micrometer"}
AXES = {"c": {"type": "channel"}, "y": _UM, "x": _UM}
CHUNK_PX = 1024
"""Side of a chunk in px: a field of a usual camera is a few files."""


def write_scene(
    path: Path,
    fields: Iterable[tuple[str, HeightMap]],
    poses: Poses,
    about: dict[str, Any],
    progress: Progress | None = None,
    should_stop: ShouldStop | None = None,
) -> None:
    """Write fields, in the order of `poses`, by name; about: an attribute of the scene.

    Raises DatasetError when the name has another ending, the path exists or cannot be written to, or the work is
    stopped; then nothing is left.
    """
    import zarr

    if path.suffix != ENDING:
        raise DatasetError(f"{path.name} is not the name of a scene: give one such as {path.stem}.ome.zarr.")
    require_free(path)
    with atomic_write(path) as temporary:
        root = zarr.create_group(temporary, zarr_format=3)
        each = with_progress(enumerate(fields), poses.numbers.size, "Writing the fields", progress, should_stop)
        images = [_write_field(root.create_group(name), surface, poses, n) for n, (name, surface) in each]
        lowest, highest = _hull(np.array([image.extremes for image in images]))
        for image in images:
            image.group.attrs.update(_image(image, lowest, highest))
        root.attrs.update(_scene(images, poses) | {OWN: about})


@dataclass(frozen=True, slots=True)
class FieldImage:
    """Image of a field that is written.

    corner_um: (x, y) of its first pixel from the field's centre; extremes: (least, greatest) value of each channel.
    """

    group: zarr.Group
    pixel_um: float
    n_levels: int
    corner_um: tuple[float, float]
    extremes: Sequence[tuple[float, float]]


def _write_field(group: zarr.Group, surface: HeightMap, poses: Poses, n: int) -> FieldImage:
    """Write the pyramid of a field, its channels at each level."""
    rows, cols = surface.shape
    corner_um = -(cols - 1) / 2 * surface.pixel_um, (rows - 1) / 2 * surface.pixel_um
    levels = [
        np.stack([layers[name].astype(np.float32) for name in CHANNELS])
        for layers in _pyramid(_levelled(surface, poses, n, corner_um))
    ]
    for level, pixels in enumerate(levels):
        group.create_array(str(level), data=pixels, chunks=(1, CHUNK_PX, CHUNK_PX), dimension_names=tuple(AXES))
    group.attrs[OWN] = _pose(poses, n) | {"caveats": list(caveats(surface.provenance))}
    return FieldImage(group, surface.pixel_um, len(levels), corner_um, [_extremes(channel) for channel in levels[-1]])


def _levelled(surface: HeightMap, poses: Poses, n: int, corner_um: tuple[float, float]) -> dict[str, NDArray[Any]]:
    """Return the layers of a field, as the mosaic takes them: without the errors of height that the poses solved."""
    rows, cols = surface.shape
    dx_um = np.asarray(corner_um[0] + np.arange(cols) * surface.pixel_um, np.float64)
    dy_um = np.asarray(corner_um[1] - np.arange(rows)[:, None] * surface.pixel_um, np.float64)
    layers = {name: layer for name in SURFACE if (layer := getattr(surface, name)) is not None}
    return layers | {"z_um": surface.z_um - poses.excess_um(n, dx_um, dy_um).astype(np.float32)}


def _pyramid(layers: dict[str, NDArray[Any]]) -> Iterator[dict[str, NDArray[Any]]]:
    """Yield the layers at full and at halved resolutions, until the image is small."""
    from wafer_viewer.numerics.grids.pyramid_level import halve

    yield layers
    while max(layers["origin"].shape) > COARSEST_PX:
        yield (layers := halve(layers))


def _extremes(channel: NDArray[Any]) -> tuple[float, float]:
    """Return the least and the greatest value; an empty range, from inf to -inf, if there is none."""
    known = np.isfinite(channel)
    return float(np.min(channel, where=known, initial=np.inf)), float(np.max(channel, where=known, initial=-np.inf))


def _hull(extremes: NDArray[np.float64]) -> tuple[list[float], list[float]]:
    """Return the least and the greatest value of each channel in all fields, 0 if there is none."""
    lowest, highest = extremes[..., 0].min(axis=0), extremes[..., 1].max(axis=0)
    return (np.where(lowest <= highest, lowest, 0.0).tolist(), np.where(lowest <= highest, highest, 0.0).tolist())


def _image(image: FieldImage, lowest: Sequence[float], highest: Sequence[float]) -> dict[str, Any]:
    """Return the metadata of an image: pixels of each level to um from its first one, and the range to show."""

    def dataset(level: int) -> dict[str, Any]:
        size_um, shift_um = image.pixel_um * 2**level, image.pixel_um * (2**level - 1) / 2
        scale = {"type": "scale", "scale": [1.0, size_um, size_um]}
        steps = [scale, {"type": "translation", "translation": [0.0, shift_um, shift_um]}]
        place = {"type": "sequence", "transformations": steps} if level else scale
        ends = {"input": {"path": str(level)}, "output": {"name": FIELD}}
        return {"path": str(level), "coordinateTransformations": [place | ends]}

    datasets = [dataset(level) for level in range(image.n_levels)]
    multiscale = {"name": image.group.basename, "coordinateSystems": [_system(FIELD)], "datasets": datasets}
    channels = [
        {
            "label": name,
            "color": "FFFFFF",
            "active": name == CHANNELS[0],
            "window": {"start": low, "end": high, "min": low, "max": high},
        }
        for name, low, high in zip(CHANNELS, lowest, highest, strict=True)
    ]
    return {"ome": {"version": NGFF_SCENE_VERSION, "multiscales": [multiscale], "omero": {"channels": channels}}}


def _scene(images: Sequence[FieldImage], poses: Poses) -> dict[str, Any]:
    """Return the metadata of a scene: where the first pixel of each image lies."""

    def placed(system: str, image: FieldImage, x_um: float, y_um: float) -> dict[str, Any]:
        name = image.group.basename
        first = [0.0, -y_um - image.corner_um[1], x_um + image.corner_um[0]]
        ends = {"input": {"path": name, "name": FIELD}, "output": {"name": system}}
        return {"type": "translation", "translation": first, "name": f"{name} {system}", **ends}

    systems = {STITCHED: (poses.x_um, poses.y_um), STAGE: (poses.stage_x_um, poses.stage_y_um)}
    transformations = [
        placed(system, image, float(x_um[n]), float(y_um[n]))
        for system, (x_um, y_um) in systems.items()
        for n, image in enumerate(images)
        if system == STAGE or not poses.left_out[n]
    ]
    scene = {"coordinateSystems": [_system(one) for one in systems], "coordinateTransformations": transformations}
    return {"ome": {"version": NGFF_SCENE_VERSION, "scene": scene}}


def _system(name: str) -> dict[str, Any]:
    return {"name": name, "axes": [{"name": axis, **kind} for axis, kind in AXES.items()]}


def _pose(poses: Poses, n: int) -> dict[str, Any]:
    """Return the pose of a field: positions of its centre by stage and solution in um, and what its heights lost."""
    names = ("numbers", "stage_x_um", "stage_y_um", "x_um", "y_um", "u_x_um", "u_y_um", "z_um", "u_z_um")
    columns = (*names, "tilt_x", "tilt_y", "group", "left_out")
    return {name: _finite(getattr(poses, name)[n].item()) for name in columns}


def _finite(value: float) -> float | None:
    """Return a number, None for an uncertainty that is infinite: JSON has none."""
    return value if np.isfinite(value) else None
