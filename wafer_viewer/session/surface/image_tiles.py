"""One picture of a grid of single images that overlap, such as a mosaic of a microscope without z."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from wafer_viewer._version import __version__
from wafer_viewer.model.acquisition.focus_stack import Image
from wafer_viewer.model.acquisition.image_source import Corner, GridOrder, ImageOptions, Mirror
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import Progress, ShouldStop, never, part_of, silent, with_progress
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.field_poses import Poses
from wafer_viewer.model.surface.height_map import HeightMap, Origin, Provenance
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.blending.mosaic_layout import MosaicLayout
from wafer_viewer.reconstruct.blending.stitched_mosaic import blend_pictures
from wafer_viewer.reconstruct.registration.grid_steps import find_steps
from wafer_viewer.reconstruct.stitching import stitch
from wafer_viewer.store.dataset.stack_import import OVERLAP_FRACTION, placed_fields
from wafer_viewer.store.formats.ome_pyramid import TILE_PX, PyramidHeader, PyramidImage, write_picture
from wafer_viewer.store.images.image_files import Paths
from wafer_viewer.store.images.stack_source import ImportSource, UnsettledValue, read_source
from wafer_viewer.store.io.atomic_files import atomic_write

READ_SHARE, PLACED_SHARE = 0.2, 0.7
"""Fractions of the progress bar after reading the images and after placing them."""
ENDINGS = (".ome.tif", ".ome.tiff", ".tif", ".tiff")
COLUMNS = ("x_um", "y_um", "u_x_um", "u_y_um")


def stitch_images(
    srcs: Paths,
    out: str | Path,
    table: str | Path | None = None,
    pixel_um: float | None = None,
    pattern: str | None = None,
    overlap_fraction: float = OVERLAP_FRACTION,
    recipe: Recipe = Recipe(),
    progress: Progress = silent,
    should_stop: ShouldStop = never,
    *,
    channel: str | None = None,
    time: str | None = None,
    only: str | None = None,
    columns: int | None = None,
    order: GridOrder = "rows",
    corner: Corner = "top-left",
    mirror: Mirror = "none",
    places: str | Path | None = None,
) -> Poses:
    """Stitch single images of a grid, one a field, to one picture, and write it.

    Parameters
    ----------
    srcs : str, Path or sequence of them
        Folder of images, an image file with several positions, or several files.
    out : str or Path
        File to write: ``NAME.ome.tif`` with a pyramid, or ``NAME.tif``. An existing one is replaced.
    table : str or Path, optional
        CSV file to write with the place of each image, which `places` takes again.
    pixel_um : float, optional
        Pixel size on the sample in um, required where the files do not say it.
    pattern : str, optional
        Pattern of the file names with the parts ``{row}`` and ``{col}``, or ``{n}``. Default: places are those that
        the files or `places` state.
    overlap_fraction : float, default 0.1
        Overlap of neighbours on the grid of `pattern`, where the images do not tell it.
    recipe : Recipe, optional
        Settings, of which those of stitching are used.
    progress : callable, optional
        Receives the completed fraction, 0 to 1.
    should_stop : callable, optional
        Returns True if the work should stop.
    channel, time, only : str, optional
        Choices where the files have several; see `open_stack`.
    columns, order, corner, mirror, places : optional
        Numbers of a grid, or a table of the places; see `import_dataset`.

    Returns
    -------
    Poses
        Place of each image, in the order of `places` or of the grid, with notes.

    Raises
    ------
    DatasetError
        When there is no image, or only one, the files are damaged, several channels or times are there and none is
        chosen, places or the pixel size are unknown, a field has several frames, the file cannot be written, or the
        work is stopped.
    ComputeError
        When no image fits its neighbours.
    """
    options = ImageOptions(
        pixel_um=pixel_um,
        pattern=pattern,
        channel=channel,
        time=time,
        only=only,
        columns=columns,
        order=order,
        corner=corner,
        mirror=mirror,
        places=None if places is None else Path(places),
    )
    to = Path(out), None if table is None else Path(table)
    return write_stitched(srcs, *to, options, overlap_fraction, recipe, progress=progress, should_stop=should_stop)


def write_stitched(
    src: Paths,
    out: Path,
    table: Path | None,
    options: ImageOptions,
    overlap_fraction: float = OVERLAP_FRACTION,
    recipe: Recipe = Recipe(),
    *,
    progress: Progress = silent,
    should_stop: ShouldStop = never,
) -> Poses:
    """Stitch images and write picture and table; see `stitch_images`. options: values and choices of the user."""
    if not out.name.lower().endswith(ENDINGS):
        raise DatasetError(f"{out.name} has no ending of a picture: take NAME.ome.tif, with a pyramid, or NAME.tif.")
    source = _tiles(src, options)
    told = with_progress(
        source.fields, len(source.fields), "Reading the images", part_of(progress, 0, READ_SHARE), should_stop
    )
    pictures = [plane.read() for field in told for plane in field.slots[0][:1] if plane is not None]
    maps = _flat_maps(pictures, source)
    fields, assumed = _placed(source, maps, overlap_fraction, recipe)
    registering = part_of(progress, READ_SHARE, PLACED_SHARE)
    made_up = replace(maps[0].provenance, positions_assumed=assumed)
    stitched = stitch([replace(one, provenance=made_up) for one in maps], fields, recipe, registering)
    poses = stitched.poses
    assert poses is not None
    _write_picture(out, pictures, stitched.layout, source, progress, should_stop)
    if table is not None:
        _write_table(table, source, poses)
    progress(1.0)
    return poses


def _tiles(src: Paths, options: ImageOptions) -> ImportSource:
    """Return the images as fields of one image each. Raises DatasetError where they are stacks, or lack places."""
    if options.pattern is None:
        options = replace(options, as_listed=True)
    no_tiles = DatasetError(
        "The images do not say where they lie, and are taken for a stack: say it with --places or --pattern, as in "
        "'r{row}_c{col}.tif' or 'tile_{n}.tif' --columns 4; import stacks instead."
    )
    try:
        source = read_source(src, options)
    except UnsettledValue as missing:
        raise (no_tiles if missing.name == "z step" else missing) from missing
    if not source.is_tiled:
        raise no_tiles
    return source


# --- places


def _flat_maps(pictures: Sequence[Image], source: ImportSource) -> list[HeightMap]:
    """Return the images as level maps, which share their layers."""
    layers: dict[tuple[int, ...], Any] = {}
    for picture in pictures:
        layers.setdefault(picture.shape, (np.zeros(picture.shape, np.float32), np.zeros(picture.shape, np.uint8)))
    provenance = Provenance(software_version=__version__, simulated=source.simulated)
    maps: list[HeightMap] = []
    for picture in pictures:
        level, measured = layers[picture.shape]
        measured[...] = Origin.MEASURED
        maps.append(HeightMap(level, level, level, picture, measured, source.pixel_um.value, 0.0, 0.0, provenance))
    return maps


def _placed(
    source: ImportSource, maps: Sequence[HeightMap], overlap_fraction: float, recipe: Recipe
) -> tuple[tuple[Field, ...], bool]:
    """Return the fields where they are stated, else on a grid whose steps the images tell; and whether that was so."""
    fields = placed_fields(source, maps[0].all_in_focus, overlap_fraction)
    stated = all(field.x_um is not None and field.y_um is not None for field in source.fields)
    if stated or recipe.stitching.poses == "stage" or len({one.shape for one in maps}) > 1:
        return fields, not stated
    steps = find_steps([(field.row, field.col) for field in fields], maps.__getitem__)
    if steps is None:
        return fields, True
    pixel_um = source.pixel_um.value
    at_um = [(right * pixel_um, -down * pixel_um) for down, right in (steps.at_px((f.row, f.col)) for f in fields)]
    return tuple(replace(f, x_um=x, y_um=y) for f, (x, y) in zip(fields, at_um, strict=True)), True


# --- picture and table


def _write_picture(
    out: Path,
    pictures: Sequence[Image],
    lattice: MosaicLayout,
    source: ImportSource,
    progress: Progress,
    should_stop: ShouldStop,
) -> None:
    rows, cols = lattice.shape
    tops = range(0, rows, TILE_PX)
    told = with_progress(tops, len(tops), "Writing the picture", part_of(progress, PLACED_SHARE, 1), should_stop)

    def bands() -> Iterator[Image]:
        for top in told:
            yield blend_pictures(pictures, lattice, slice(top, min(top + TILE_PX, rows)), slice(0, cols))

    pixel_um = lattice.pixel_um
    facts = {"software": f"Wafer Viewer {__version__}", "SIMULATED": source.simulated, "notes": source.notes}
    header = PyramidHeader(
        pixel_um,
        lattice.x0_um + (cols - 1) / 2 * pixel_um,
        lattice.y0_um - (rows - 1) / 2 * pixel_um,
        "SIMULATED. Stitched picture." if source.simulated else "Stitched picture.",
        json.dumps(facts),
    )
    with atomic_write(out) as temporary:
        image = PyramidImage("picture", lattice.shape, pictures[0].dtype, bands())
        write_picture(temporary, image, header, with_levels=".ome." in out.name.lower())


def _write_table(table: Path, source: ImportSource, poses: Poses) -> None:
    """Write the centre of each image in um on the stage, with its standard uncertainty (k = 1), as CSV."""
    names = [plane.name for field in source.fields for plane in field.slots[0][:1] if plane is not None]
    values = zip(*(getattr(poses, name).tolist() for name in (*COLUMNS, "left_out")), strict=True)
    with atomic_write(table) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("file", *COLUMNS, "left_out"))
        for name, (*numbers, left_out) in zip(names, values, strict=True):
            writer.writerow((name, *(f"{value:.4f}" for value in numbers), int(left_out)))
