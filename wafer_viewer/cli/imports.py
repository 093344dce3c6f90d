"""Commands that look at files of other programs and import them."""

from __future__ import annotations

from wafer_viewer.cli.arguments import Images, Out, Sources, Text, require_sources
from wafer_viewer.cli.output import audit, print_contents, print_json, progress, warn


def inspect(
    src: Sources,
    images: Images,
    z_unit: Text = None,
    invert_z: bool = False,
    quick: bool = False,
    json: bool = False,
) -> int:
    """Print what files hold that may be imported: axes, lengths with their sources, frames in order, and doubts.

    Nothing is written. Status 1 when something has to be settled before the import; each doubt names the flag.

    Args:
        src: A folder of images, an image file, image files in their order, a surface file, or a NAME.wafer.
        z_unit: Unit of the heights, where a surface file does not say it.
        invert_z: The numbers of a surface file are depths: invert them.
        quick: Do not read the images for their sharpness and the order that it supports.
        json: Print JSON, with the sharpness of each frame, instead of a table.
    """
    from wafer_viewer.model.surface_format import Reading
    from wafer_viewer.store.dataset.file_contents import file_contents

    require_sources(src)
    says = Reading(z_unit=z_unit, pixel_um=images.pixel_um, invert_z=invert_z)
    with progress("Reading") as tell:
        found = file_contents(src, images, says, look=not quick, progress=tell)
    print_json(found) if json else print_contents(found)
    return 0 if found.can_import else 1


def import_(
    src: Sources,
    out: Out,
    images: Images,
    overlap_fraction: float = 0.1,
    z_unit: Text = None,
    invert_z: bool = False,
) -> None:
    """Make a dataset of images taken elsewhere, one field or a grid told apart by a name pattern, or of a surface file.

    Args:
        src: A folder of images, a multi-page TIFF, or image files in their order; or one surface file, such as .x3p.
        out: The dataset, NAME.wafer.
        overlap_fraction: Overlap of neighbouring fields.
        z_unit: Unit of the heights, where a surface file does not say it.
        invert_z: The numbers of a surface file are depths: invert them.
    """
    from wafer_viewer.model.surface_format import Reading
    from wafer_viewer.session.files.file_jobs import import_surface
    from wafer_viewer.store.dataset.stack_import import dataset_of
    from wafer_viewer.store.formats.conversion import is_surface_file

    require_sources(src)
    if len(src) == 1 and is_surface_file(src[0]):
        with progress("Import") as tell:
            says = Reading(z_unit=z_unit, pixel_um=images.pixel_um, invert_z=invert_z)
            import_surface(src[0], out, says, progress=tell)
        print(f"{out}: a surface without frames")
        audit(out.absolute().parent, "Surface imported", out.name, f"path: {src[0].name}")
        return
    with progress("Import") as tell:
        dataset = dataset_of(src, out, images, overlap_fraction, tell, warn=warn)
    exposures = f" in {dataset.n_exposures} exposures" if dataset.n_exposures > 1 else ""
    print(f"{out}: {len(dataset.fields)} fields of {dataset.scan.plan.sweep.n_frames} frames{exposures}")
    audit(out.absolute().parent, "Images imported", out.name, f"paths: {', '.join(path.name for path in src)}")
