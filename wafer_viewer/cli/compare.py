"""Command that compares two surfaces. The signature of a command defines its flags, its docstring is the help."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
from tyro.conf import Positional, arg

from wafer_viewer.cli.output import print_json, progress, warn
from wafer_viewer.model.errors import DatasetError
from wafer_viewer.model.surface.comparison import Align, Comparison, Heights, SurfaceName

First = Annotated[Positional[Path], arg(metavar="FIRST")]
Second = Annotated[Positional[Path], arg(metavar="SECOND")]
Place = Annotated[Path | None, arg(aliases=("-o",), metavar="FILE|NAME")]


def compare(
    first: First,
    second: Second,
    out: Place = None,
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
    from wafer_viewer.store.formats.exporters import export, losses, require_known

    if out is not None and not out.suffix:
        if Path(one.path).suffix != ".wafer" or out.name != str(out):
            raise DatasetError(
                f"{out} is not a file: give it an ending such as .npz, or compare with a NAME.wafer first."
            )
        with progress("Comparison") as tell:
            return keep_difference(Path(one.path), out.name, one, other, align, keep_z, tell)
    if out is not None:
        require_known(out)
    difference, numbers = compare_files(one, other, align, keep_z)
    if out is not None:
        export(difference, out)
        for sentence in losses(difference, out):
            warn(f"{out.name}: {sentence}")
    return numbers()
