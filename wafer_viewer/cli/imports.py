"""Commands that look at files of other programs, import them, and do one thing on many of them."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec
from tyro.conf import Suppress

from wafer_viewer.cli.arguments import File, Images, Out, Sources, Text, Word, require_sources
from wafer_viewer.cli.output import audit, print_contents, print_json, progress, warn
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.file_contents import DATASET_ENDING
from wafer_viewer.model.surface_format import Table


def inspect(
    src: Sources,
    images: Images,
    z_unit: Text = None,
    invert_z: bool = False,
    table: Table = None,
    quick: bool = False,
    json: bool = False,
) -> int:
    """Print what files hold that may be imported: axes, lengths with their sources, frames in order, and doubts.

    Nothing is written. Status 1 when something has to be settled before the import; each doubt names the flag.

    Args:
        src: A folder of images, an image file, image files in their order, a surface file, or a NAME.wafer.
        z_unit: Unit of the heights, where a surface file does not say it.
        invert_z: The numbers of a surface file are depths: invert them.
        table: Whether the lines of a text file are points or the rows of a matrix, where that is not clear.
        quick: Do not read the images for their sharpness and the order that it supports.
        json: Print JSON, with the sharpness of each frame, instead of a table.
    """
    from wafer_viewer.model.surface_format import Reading
    from wafer_viewer.store.dataset.file_contents import file_contents

    require_sources(src)
    says = Reading(z_unit=z_unit, pixel_um=images.pixel_um, invert_z=invert_z, table=table)
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
    table: Table = None,
) -> None:
    """Make a dataset of images taken elsewhere, one field or a grid told apart by a name pattern, or of a surface file.

    Args:
        src: A folder of images, a multi-page TIFF, or image files in their order; or one surface file, such as .x3p.
        out: The dataset, NAME.wafer.
        overlap_fraction: Overlap of neighbouring fields.
        z_unit: Unit of the heights, where a surface file does not say it.
        invert_z: The numbers of a surface file are depths: invert them.
        table: Whether the lines of a text file are points or the rows of a matrix, where that is not clear.
    """
    from wafer_viewer.model.surface_format import Reading
    from wafer_viewer.session.files.file_jobs import import_surface
    from wafer_viewer.store.dataset.stack_import import dataset_of
    from wafer_viewer.store.formats.conversion import is_surface_file

    require_sources(src)
    if len(src) == 1 and is_surface_file(src[0]):
        with progress("Import") as tell:
            says = Reading(z_unit=z_unit, pixel_um=images.pixel_um, invert_z=invert_z, table=table)
            import_surface(src[0], out, says, progress=tell)
        print(f"{out}: a surface without frames")
        audit(out.absolute().parent, "Surface imported", out.name, f"path: {src[0].name}")
        return
    with progress("Import") as tell:
        dataset = dataset_of(src, out, images, overlap_fraction, tell, warn=warn)
    exposures = f" in {dataset.n_exposures} exposures" if dataset.n_exposures > 1 else ""
    print(f"{out}: {len(dataset.fields)} fields of {dataset.scan.plan.sweep.n_frames} frames{exposures}")
    audit(out.absolute().parent, "Images imported", out.name, f"paths: {', '.join(path.name for path in src)}")


OUTPUTS: dict[str, tuple[str, ...]] = {"import": ("-o",), "reconstruct": ("-o",), "report": ("-o",), "convert": ()}
ENDINGS = {"import": DATASET_ENDING, "report": ".html"}
"""Commands of a batch that write a file for each source, with the words before its name; and the ending of their only
format."""


def batch(
    command: Word,
    src: Sources,
    to: File = None,
    ending: str = "",
    table: File = None,
    again: bool = False,
    words: Annotated[tuple[str, ...], Suppress] = (),
    run: Annotated[Callable[[list[str]], int | None] | None, Suppress] = None,
) -> int:
    """Run a command on many files, one after the other; what stands after `--` goes to the command.

    A file that fails is told and the next one follows; status 1 at the end. With --table each file has a line, with the
    numbers that a measurement gives; run again, the batch goes on where it ended, and files that are done and unchanged
    are left. Ctrl-C ends it after the line of the present file.

        wafer-viewer batch reconstruct 'stacks/*' --to surfaces --ending .x3p --table all.csv -- --z-step-um 2
        wafer-viewer batch 'measure texture' 'surfaces/*.x3p' --table texture.csv -- --region 0 0 500 500

    Args:
        command: import, reconstruct, convert, inspect, stitch, report, or a measurement such as 'measure texture'.
        src: Files, folders, or patterns such as 'data/*.tif'.
        to: Folder of the files that are written.
        ending: Ending of their names, which picks the format; .wafer for import, .html for report.
        table: CSV file with a line for each source.
        again: Also do what the table has as done.
    """
    from wafer_viewer.session.files.batch import expanded, output_names, run_batch

    paths = expanded(src)
    outs = _outputs(command, paths, to, ending or ENDINGS.get(command, ""), output_names)
    assert run is not None

    def work(path: Path) -> Mapping[str, Any]:
        out = outs.get(path)
        given = [*command.split(), str(path), *([] if out is None else [*OUTPUTS[command], str(out)]), *words]
        return _run_captured(run, given, out)

    def told(row: Mapping[str, Any]) -> None:
        end = f"done in {row['seconds']} s" if row["status"] == "done" else row["message"]
        print(f"{row['source']}: {end}", flush=True)

    name = " ".join([command, *words, *([] if to is None else [str(to), ending])])
    with progress("Batch") as tell:
        report = run_batch(paths, work, table, name=name, again=again, progress=tell, told=told)
    kept = f", {report.kept} were done before" if report.kept else ""
    print(f"{report.done} done, {report.failed} failed{kept}" + ("" if table is None else f": {table}"))
    return 1 if report.failed else 0


def _outputs(
    command: str, paths: list[Path], to: Path | None, ending: str, named: Callable[..., dict[Path, Path]]
) -> dict[Path, Path]:
    if command not in OUTPUTS:
        return {}
    if to is None or not ending.startswith("."):
        raise DatasetError(f"{command} writes a file for each source: say where, as in --to FOLDER --ending .x3p.")
    to.mkdir(parents=True, exist_ok=True)
    return named(paths, to, ending)


def _run_captured(run: Callable[[list[str]], int | None], argv: list[str], out: Path | None) -> Mapping[str, Any]:
    """Run a command and return the JSON that it prints, or its output. Raises DatasetError when it fails."""
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed):
            status = run(argv) or 0
    except SystemExit as end:
        raise DatasetError(f"{' '.join(argv[:2])} refused its flags: see wafer-viewer {argv[0]} --help.") from end
    text = printed.getvalue()
    if status:
        raise DatasetError(" ".join(text.split())[:300] or f"{argv[0]} ended with status {status}.")
    try:
        found = msgspec.json.decode(text)
    except msgspec.DecodeError:
        found = {}
    return ({} if out is None else {"output": str(out)}) | (found if isinstance(found, dict) else {})
