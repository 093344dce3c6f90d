"""One surface of several surface files that overlap, such as height maps of a confocal microscope."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from wafer_viewer.model.acquisition.image_source import ImageOptions
from wafer_viewer.model.acquisition.plan import Field
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.progress import Progress, part_of
from wafer_viewer.model.surface.height_map import HeightMap, Mosaic
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.model.surface_format import Reading
from wafer_viewer.reconstruct.stitching import stitch
from wafer_viewer.store.formats.conversion import read_surface
from wafer_viewer.store.images.name_pattern import Cell, compile_pattern
from wafer_viewer.store.images.tile_places import matched, mirrored, numbered_cells, places_of

READ_SHARE = 0.3
Centres = list[tuple[float, float]]


def stitch_files(
    paths: Sequence[Path],
    options: ImageOptions = ImageOptions(),
    overlap_fraction: float = 0.1,
    reading: Reading = Reading(),
    recipe: Recipe = Recipe(),
    progress: Progress = lambda fraction: None,
) -> Mosaic:
    """Read surface files, place them, and stitch them.

    They lie where a table of `options.places` says, on the grid of `options.pattern`, or where they say themselves.
    Raises DatasetError when a file is not read or its place is unknown, ComputeError when none fits its neighbours.
    """
    heights = list[HeightMap]()
    for n, path in enumerate(paths):
        progress(READ_SHARE * n / len(paths))
        given = reading.z_unit, reading.pixel_um, reading.invert_z
        heights.append(read_surface(path, *given, table=reading.table))
    centres = _centres(paths, heights, options, overlap_fraction)
    fields = [
        Field(number=n, row=0, col=n - 1, x_um=x_um, y_um=y_um, z_start_um=0.0)
        for n, (x_um, y_um) in enumerate(centres, 1)
    ]
    return stitch(heights, fields, recipe, part_of(progress, READ_SHARE, 1))


def _centres(paths: Sequence[Path], heights: Sequence[HeightMap], options: ImageOptions, overlap: float) -> Centres:
    """Return the centres of the files on the stage in um."""
    pixel_um = heights[0].pixel_um
    if options.places is not None:
        names = [[path.name, path.stem] for path in paths]
        found = [place.um(pixel_um) for place in matched(places_of(options.places), names, options.places.name)]
        return [mirrored(x_um, y_um, options.mirror) for x_um, y_um in found]
    if options.pattern is not None:
        rows, cols = heights[0].z_um.shape
        across_um, down_um = cols * pixel_um * (1 - overlap), rows * pixel_um * (1 - overlap)
        cells = _cells(paths, options)
        return [mirrored(col * across_um, -row * down_um, options.mirror) for row, col in cells]
    own = [(float(one.x_um.mean()), float(one.y_um.mean())) for one in heights]
    if len(set(own)) < len(own):
        raise DatasetError(
            "The files do not say where they lie: say it with --places, or with --pattern, as in 'r{row}_c{col}.x3p' "
            "or 'tile_{n}.x3p' --columns 4."
        )
    return own


def _cells(paths: Sequence[Path], options: ImageOptions) -> list[Cell]:
    pattern = options.pattern or ""
    expression = compile_pattern(pattern)
    parts = list[dict[str, str]]()
    for path in paths:
        match = expression.fullmatch(path.name)
        if match is None:
            raise DatasetError(f"The name of {path.name} does not fit the pattern {pattern!r}: change the pattern.")
        parts.append(match.groupdict())
    if "n" in parts[0]:
        numbers = [int(one["n"]) for one in parts]
        by_number = numbered_cells(numbers, options)
        return [by_number[number] for number in numbers]
    return [(int(one["row"]), int(one["col"])) for one in parts]
