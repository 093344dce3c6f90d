"""Commands that look at files of other programs and import them."""

from __future__ import annotations

from wafer_viewer.cli.arguments import Out, Ratio, Sources, Text, Um, image_options, require_sources
from wafer_viewer.cli.output import audit, print_contents, print_json, progress, warn


def inspect(
    src: Sources,
    z_step_um: Um = None,
    pixel_um: Um = None,
    pattern: Text = None,
    z_unit: Text = None,
    invert_z: bool = False,
    na: Ratio = None,
    channel: Text = None,
    time: Text = None,
    position: Text = None,
    only: Text = None,
    as_listed: bool = False,
    overrule: bool = False,
    quick: bool = False,
    json: bool = False,
) -> int:
    """Print what files hold that may be imported: axes, lengths with their sources, frames in order, and doubts.

    Nothing is written. Status 1 when something has to be settled before the import; each doubt names the flag.

    Args:
        src: A folder of images, an image file, image files in their order, a surface file, or a NAME.wafer.
        z_step_um: Distance between frames, where SRC does not say it; negative when they were taken downward.
        pixel_um: Size of a pixel on the sample, where SRC does not say it.
        pattern: How files are named, such as r{row}_c{col}_k{k}.tif; {e} where each z was taken in several exposures.
        z_unit: Unit of the heights, where a surface file does not say it.
        invert_z: The numbers of a surface file are depths: invert them.
        na: Numerical aperture of the objective, in air.
        channel: Name of the channel to take, or its number from 0, where the files have several.
        time: The time to take, where the files have several.
        position: The position to take, where the files have several.
        only: Files to take, by a pattern of their names such as 'img_*.png'.
        as_listed: Take all files in the order given, without a look for gaps, copies and files that are no frames.
        overrule: Take the given values where the files state others.
        quick: Do not read the images for their sharpness and the order that it supports.
        json: Print JSON, with the sharpness of each frame, instead of a table.
    """
    from wafer_viewer.model.surface_format import Reading
    from wafer_viewer.store.dataset.file_contents import file_contents

    require_sources(src)
    options = image_options(
        z_step_um=z_step_um,
        pixel_um=pixel_um,
        numerical_aperture=na,
        pattern=pattern,
        channel=channel,
        time=time,
        position=position,
        only=only,
        as_listed=as_listed,
        overrule=overrule,
    )
    says = Reading(z_unit=z_unit, pixel_um=pixel_um, invert_z=invert_z)
    with progress("Reading") as tell:
        found = file_contents(src, options, says, look=not quick, progress=tell)
    print_json(found) if json else print_contents(found)
    return 0 if found.can_import else 1


def import_(
    src: Sources,
    out: Out,
    z_step_um: Um = None,
    pixel_um: Um = None,
    pattern: Text = None,
    overlap_fraction: float = 0.1,
    z_unit: Text = None,
    invert_z: bool = False,
    na: Ratio = None,
    wavelength_um: Um = None,
    channel: Text = None,
    time: Text = None,
    position: Text = None,
    only: Text = None,
    as_listed: bool = False,
    overrule: bool = False,
) -> None:
    """Make a dataset of images taken elsewhere, one field or a grid told apart by a name pattern, or of a surface file.

    Args:
        src: A folder of images, a multi-page TIFF, or image files in their order; or one surface file, such as .x3p.
        out: The dataset, NAME.wafer.
        z_step_um: Distance between frames, where SRC does not say it; negative when they were taken downward.
        pixel_um: Size of a pixel on the sample, where SRC does not say it.
        pattern: How files are named, such as r{row}_c{col}_k{k}.tif; {e} where each z was taken in several exposures.
        overlap_fraction: Overlap of neighbouring fields.
        z_unit: Unit of the heights, where a surface file does not say it.
        invert_z: The numbers of a surface file are depths: invert them.
        na: Numerical aperture of the objective, in air: bounds the width of focus curves.
        wavelength_um: Of the light; 0.55 um where it is not given.
        channel: Name of the channel to take, or its number from 0, where the files have several.
        time: The time to take, where the files have several.
        position: The position to take, where the files have several.
        only: Files to take, by a pattern of their names such as 'img_*.png'.
        as_listed: Take all files in the order given, without a look for gaps, copies and files that are no frames.
        overrule: Take the given values where the files state others.
    """
    from wafer_viewer.model.surface_format import Reading
    from wafer_viewer.session.files.file_jobs import import_surface
    from wafer_viewer.store.dataset.stack_import import dataset_of
    from wafer_viewer.store.formats.conversion import is_surface_file

    require_sources(src)
    if len(src) == 1 and is_surface_file(src[0]):
        with progress("Import") as tell:
            says = Reading(z_unit=z_unit, pixel_um=pixel_um, invert_z=invert_z)
            import_surface(src[0], out, says, progress=tell)
        print(f"{out}: a surface without frames")
        audit(out.absolute().parent, "Surface imported", out.name, f"path: {src[0].name}")
        return
    options = image_options(
        z_step_um=z_step_um,
        pixel_um=pixel_um,
        numerical_aperture=na,
        wavelength_um=wavelength_um,
        pattern=pattern,
        channel=channel,
        time=time,
        position=position,
        only=only,
        as_listed=as_listed,
        overrule=overrule,
    )
    with progress("Import") as tell:
        dataset = dataset_of(src, out, options, overlap_fraction, tell, warn=warn)
    exposures = f" in {dataset.n_exposures} exposures" if dataset.n_exposures > 1 else ""
    print(f"{out}: {len(dataset.fields)} fields of {dataset.scan.plan.sweep.n_frames} frames{exposures}")
    audit(out.absolute().parent, "Images imported", out.name, f"paths: {', '.join(path.name for path in src)}")
