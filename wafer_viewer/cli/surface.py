"""Surface commands. The signature of a command defines its flags, its docstring is its help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
from tyro.conf import Positional, arg

from wafer_viewer.cli.arguments import (
    Count,
    DatasetFolder,
    File,
    Images,
    NewFile,
    Out,
    Place,
    Source,
    Sources,
    Text,
    Um,
    require_sources,
)
from wafer_viewer.cli.output import audit, print_json, print_surface, progress, warn
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.file_contents import DATASET_ENDING
from wafer_viewer.model.file_formats import with_suffixes
from wafer_viewer.model.report import PARTS, Language, Paper, Part, ReportOrder
from wafer_viewer.model.surface.comparison import Align, Comparison, Heights, SurfaceName
from wafer_viewer.model.surface.height_map import Mosaic
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.model.surface_format import Table

OF_THE_PAGE = ("stamp", "changed")
"""Fields of the surface info that only the page needs."""


def reconstruct(
    src: Sources,
    out: Out,
    images: Images,
    recipe: Recipe = Recipe(),
    result: str = "default",
    scheduler: Text = None,
    workers: Count = None,
) -> None:
    """Make a surface and write it to a file, whose ending picks the format; `convert --help` names them.

    Args:
        src: A folder of images, a multi-page TIFF, image files, or one NAME.wafer, of which the mosaic is written.
        out: The file.
        recipe: --recipe RECIPE.toml gives all settings, --recipe.FIELD VALUE single ones.
        result: Name under which a NAME.wafer keeps its surfaces.
        scheduler: A dask cluster that works on a NAME.wafer, tls://HOST:PORT.
        workers: Processes of this machine that work on a NAME.wafer; 1 is this one alone. As many as help by default.
    """
    from wafer_viewer.session.surface.headless import LocalOrCluster, surface_of
    from wafer_viewer.store.formats.conversion import require_format

    require_sources(src)
    require_format(out)
    hire = LocalOrCluster(scheduler, workers)
    with progress("Reconstruction") as tell:
        surface, info = surface_of(src, recipe, images, result, tell, warn, hire)
    _write(surface, out)
    print_surface(out, info)


def stitch(
    dataset: DatasetFolder,
    recipe: Recipe = Recipe(),
    result: str = "default",
    again: bool = False,
    poses: File = None,
    scheduler: Text = None,
    workers: Count = None,
) -> None:
    """Make the stitched surface of a dataset; fields that have no heights yet get theirs first.

    Args:
        dataset: The dataset.
        recipe: --recipe RECIPE.toml gives all settings, --recipe.FIELD VALUE single ones.
        result: Name under which the surfaces are kept.
        again: Make the heights of all fields again.
        poses: Also write where each field lies, with uncertainties, as CSV.
        scheduler: A dask cluster that does the work, tls://HOST:PORT.
        workers: Processes of this machine that do the work; 1 is this one alone. As many as help by default.
    """
    from wafer_viewer.session.surface.headless import LocalOrCluster, make_surface, write_poses_of

    hire = LocalOrCluster(scheduler, workers)
    with progress("Stitching") as tell:
        info = make_surface(dataset, recipe, result, again=again, tell=tell, warn=warn, hire=hire)
    audit(dataset.absolute().parent, "Surface made", dataset.name, f"result: {result}")
    if poses is not None:
        write_poses_of(dataset, result, poses)
    print_json({name: value for name, value in msgspec.to_builtins(info).items() if name not in OF_THE_PAGE})


def stitch_surfaces(
    src: Sources,
    out: Out,
    images: Images,
    recipe: Recipe = Recipe(),
    overlap_fraction: float = 0.1,
    z_unit: Text = None,
    invert_z: bool = False,
    table: Table = None,
) -> None:
    """Make one surface of several surface files that overlap, such as height maps of another instrument.

    They lie where a table of --places says, on the grid of --pattern, or where they say themselves; their overlaps
    correct that.

    Args:
        src: The surface files, all with the same pixel size.
        out: The file.
        recipe: --recipe RECIPE.toml gives all settings, of which those of stitching are used.
        overlap_fraction: Overlap of neighbours on the grid of --pattern.
        z_unit: Unit of the heights, where the files do not say it.
        invert_z: The numbers of the files are depths: invert them.
        table: Whether the lines of text files are points or the rows of a matrix, where that is not clear.
    """
    from wafer_viewer.model.surface_format import Reading
    from wafer_viewer.session.surface.surface_tiles import stitch_files
    from wafer_viewer.store.formats.conversion import require_format

    require_sources(src)
    require_format(out)
    says = Reading(z_unit=z_unit, pixel_um=images.pixel_um, invert_z=invert_z, table=table)
    with progress("Stitching") as tell:
        surface = stitch_files(src, images, overlap_fraction, says, recipe, tell)
    _write(surface, out)
    for note in surface.provenance.notes:
        warn(note)
    print(out)


def stitch_images(
    src: Sources,
    out: Out,
    images: Images,
    recipe: Recipe = Recipe(),
    overlap_fraction: float = 0.1,
    poses: File = None,
) -> None:
    """Make one picture of single images that overlap, one a field, such as a grid of a microscope without z.

    They lie where a table of --places says, on the grid of --pattern, or where they say themselves; their overlaps
    correct that.

    Args:
        src: A folder of images, image files, or a file with several positions.
        out: The picture: NAME.ome.tif with a pyramid for viewers of large images, or NAME.tif.
        recipe: --recipe RECIPE.toml gives all settings, of which those of stitching are used.
        overlap_fraction: Overlap of neighbours on the grid of --pattern, where the images do not tell it.
        poses: Also write where each image lies, with uncertainties, as CSV; --places takes it again.
    """
    from wafer_viewer.session.surface.image_tiles import write_stitched

    require_sources(src)
    with progress("Stitching") as tell:
        found = write_stitched(
            src[0] if len(src) == 1 else src, out, poses, images, overlap_fraction, recipe, progress=tell
        )
    for note in found.notes:
        warn(note)
    print(f"{out}: {len(found.numbers)} images, {int(found.left_out.sum())} left out")


def why(
    src: Sources,
    at: Place,
    images: Images,
    field: int = 0,
    result: str = "default",
    recipe: Recipe = Recipe(),
) -> None:
    """Explain a pixel's height or its absence: focus curve, the peak's rivals, every gate's verdict, as JSON. Stage um.

    Args:
        src: A NAME.wafer, a folder of images, a multi-page TIFF or image files.
        at: Where the pixel is.
        field: The field of a NAME.wafer that is asked; 0 takes the one whose centre is nearest.
        result: Name of the reconstruction, whose settings are used.
        recipe: Other settings: --recipe RECIPE.toml gives all, --recipe.FIELD VALUE single ones.
    """
    from wafer_viewer.session.surface.headless import evidence_of

    require_sources(src)
    with progress("Reading the frames") as tell:
        found = evidence_of(src, at, field, result, recipe, images, tell)
    print_json(msgspec.to_builtins(found))


@with_suffixes
def convert(
    src: Source,
    out: NewFile,
    every: Count = None,
    max_points: Count = None,
    z_unit: Text = None,
    pixel_um: Um = None,
    invert_z: bool = False,
    table: Table = None,
    result: str = "default",
) -> None:
    """Write a surface in another format, named by the ending; what that cannot hold is said on standard error.

    Reads NAME.wafer {READ}; writes {WRITTEN}.

    Args:
        src: A surface file, or a NAME.wafer, of which the mosaic is written.
        out: The file to write.
        every: Only every N-th row and column; all by default, of a mesh as many as make a million points.
        max_points: As many rows and columns as make at most N points.
        z_unit: Unit of the heights, such as um, where SRC does not say it; of points the unit of x and y, too.
        pixel_um: Pixel size where SRC does not say it, or what to grid scattered points on.
        invert_z: The numbers of SRC are depths: invert them.
        table: Whether the lines of a text are points or the rows of a matrix of heights, where that is not clear.
        result: Name of the reconstruction of a NAME.wafer.
    """
    from wafer_viewer.model.surface_format import Reading
    from wafer_viewer.session.surface.headless import file_or_mosaic
    from wafer_viewer.store.formats.conversion import density, require_format

    require_format(out)
    if every is not None and max_points is not None:
        raise DatasetError("--every and --max-points both say how much is written: give one of them.")
    with progress("Reading") as tell:
        says = Reading(z_unit=z_unit, pixel_um=pixel_um, invert_z=invert_z, table=table)
        surface = file_or_mosaic(src, result, says, tell)
    _write(surface, out, every or density(surface, out, max_points))
    print(out)


def _write(surface: Mosaic, out: Path, every: int | None = None) -> None:
    """Write a surface to a file; warn about content that the format cannot hold."""
    from wafer_viewer.store.formats.conversion import density, export, losses

    every = every or density(surface, out)
    with progress("Writing") as tell:
        export(surface, out, every, tell)
    for sentence in losses(surface, out, every):
        warn(f"{out.name}: {sentence}")


def fields(dataset: DatasetFolder, out: NewFile, result: str = "default") -> None:
    """Write the fields of a stitched surface as images for other programs, each where it lies: an OME-NGFF 0.6 scene.

    Args:
        dataset: The dataset.
        out: The folder to write, NAME.ome.zarr; images of two channels, picture and heights in um.
        result: Name of the reconstruction.
    """
    from wafer_viewer.session.surface.worker_tasks import write_fields

    with progress("Writing the fields") as tell:
        print(write_fields(dataset, out, result, tell))


def report(
    dataset: DatasetFolder,
    out: Out,
    title: str = "",
    number: str = "",
    customer: str = "",
    paper: Paper = "A4",
    language: Language | None = None,
    parts: tuple[Part, ...] = PARTS,
    result: str = "default",
) -> None:
    """Write the report of a dataset as one HTML file, or as PDF. The same dataset makes the same bytes.

    Args:
        dataset: The dataset.
        out: The file, FILE.html or FILE.pdf; a PDF is printed by the Chromium, Chrome or Edge of this machine. FILE.xml
            has the results for other programs, as a digital calibration certificate (DCC 3.1.2); FILE.dfq the values
            with their limits for statistical process control (Q-DAS, AQDEF).
        title: What stands over it; the dataset's name without one.
        number: Number of the report, on every page; the dataset's name and the day of the scan without one.
        customer: For whom it is made.
        paper: Size of the paper.
        language: Of the report; that of laboratory.toml in the data folder, or English, without it.
        parts: Contents, in this order; all by default.
        result: Name of the reconstruction.
    """
    from wafer_viewer.session.reporting.report import make_report

    order = ReportOrder(title=title, number=number, customer=customer, paper=paper, language=language, parts=parts)
    print(make_report(dataset, result, order, out))


First = Annotated[Positional[Path], arg(metavar="FIRST")]
Second = Annotated[Positional[Path], arg(metavar="SECOND")]
Output = Annotated[Path | None, arg(aliases=("-o",), metavar="FILE|NAME")]


def compare(
    first: First,
    second: Second,
    out: Output = None,
    align: Align = "auto",
    keep_z: bool = False,
    result: str = "default",
    second_result: str = "default",
    field: int = 0,
    second_field: int = 0,
    heights: Heights = "both",
    second_heights: Heights = "both",
) -> None:
    """The second surface minus the first, aligned before; how they were aligned and what has changed as JSON.

    Args:
        first: A NAME.wafer or a surface file; the difference lies on its lattice.
        second: Another one.
        out: A file, whose ending picks the format, or a name under which FIRST.wafer keeps the difference.
        align: images finds shift, turn, height and tilt; stage takes x and y as they are; none takes heights, too; auto
            needs nothing for two surfaces of the same frames, else takes images.
        keep_z: Leave height and tilt as they are, as against a golden surface.
        result: Name of the first's reconstruction.
        second_result: Name of the second's.
        field: A field of the first; 0 is the stitched surface.
        second_field: A field of the second.
        heights: Which of the first's heights; both subtracts measured from measured and filtered from filtered heights.
        second_heights: Which of the second's.
    """
    one = SurfaceName(path=str(first.absolute()), result=result, field=field, heights=heights)
    other = SurfaceName(path=str(second.absolute()), result=second_result, field=second_field, heights=second_heights)
    print_json(msgspec.to_builtins(_compared(one, other, align, keep_z, out)))


def _compared(one: SurfaceName, other: SurfaceName, align: Align, keep_z: bool, out: Path | None) -> Comparison:
    from wafer_viewer.session.surface.comparison_job import compare_files, keep_difference
    from wafer_viewer.store.formats.conversion import export, losses, require_format

    if out is not None and not out.suffix:
        if Path(one.path).suffix != DATASET_ENDING or out.name != str(out):
            raise DatasetError(
                f"{out} is not a file: give it an ending such as .npz, or compare with a NAME.wafer first."
            )
        with progress("Comparison") as tell:
            return keep_difference(Path(one.path), out.name, one, other, align, keep_z, tell)
    if out is not None:
        require_format(out)
    difference, numbers = compare_files(one, other, align, keep_z)
    if out is not None:
        export(difference, out)
        for sentence in losses(difference, out):
            warn(f"{out.name}: {sentence}")
    return numbers()
