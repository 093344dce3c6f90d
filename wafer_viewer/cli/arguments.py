"""Argument types of the commands."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, arg

from wafer_viewer.model.acquisition.image_source import Corner, GridOrder, ImageOptions, Mirror
from wafer_viewer.model.errors import DatasetError, MeasureError
from wafer_viewer.model.measurement.tool_options import Levelling
from wafer_viewer.model.region import Region

if TYPE_CHECKING:
    from wafer_viewer.rigs.rig_config import RigConfig

DATA_FOLDER = Path("~/wafer-viewer")

Word = Annotated[Positional[str], arg(metavar="WORD")]
Words = Annotated[Positional[tuple[str, ...]], arg(metavar="WORD ...")]
PlanFile = Annotated[Positional[Path], arg(metavar="PLAN.toml")]
DatasetFolder = Annotated[Positional[Path], arg(metavar="NAME.wafer")]
Folder = Annotated[Positional[Path], arg(metavar="FOLDER")]
Folders = Annotated[tuple[Path, ...], arg(metavar="DIR ...")]
Source = Annotated[Positional[Path], arg(metavar="SRC")]
Sources = Annotated[Positional[tuple[Path, ...]], arg(metavar="SRC ...")]
Out = Annotated[Path, arg(aliases=("-o",), metavar="FILE")]
Ratio = Annotated[float | None, arg(metavar="NUMBER")]
Um = Annotated[float | None, arg(metavar="UM")]
Us = Annotated[float | None, arg(metavar="US")]
File = Annotated[Path | None, arg(metavar="FILE")]
Count = Annotated[int | None, arg(metavar="N")]
Text = Annotated[str | None, arg(metavar="TEXT")]
Rectangle = Annotated[tuple[float, float, float, float], arg(metavar="X0 Y0 X1 Y1")]
Rectangles = Annotated[tuple[tuple[float, float, float, float], ...], arg(metavar="X0 Y0 X1 Y1 ...")]
Corners = Annotated[tuple[float, ...], arg(metavar="X Y X Y [X Y ...]")]
Line = Annotated[tuple[float, float, float, float], arg(metavar="X0 Y0 X1 Y1")]
Place = Annotated[tuple[float, float], arg(metavar="X Y")]
Numbers = Annotated[tuple[float, ...], arg(metavar="X Y ...")]
OutFile = Annotated[Path | None, arg(aliases=("-o",), metavar="FILE")]
Range = Annotated[tuple[float, float], arg(metavar="LOW HIGH")]
Integers = Annotated[tuple[int, ...], arg(metavar="N ...")]
Circle = Annotated[tuple[float, float, float], arg(metavar="X Y RADIUS")]
Level = Annotated[tuple[str, ...], arg(metavar="WAY [NUMBER ...]")]
NewFile = Annotated[Positional[Path], arg(metavar="FILE")]
_KEYWORD = inspect.Parameter.KEYWORD_ONLY


@dataclass(frozen=True, slots=True)
class Flag:
    """One flag of a command that is made of a descriptor; without a default it is required."""

    name: str
    kind: Any
    help: str
    default: Any = inspect.Parameter.empty


def with_flags(run: Callable[..., None], about: str, flags: Sequence[Flag]) -> Callable[..., None]:
    """Return `run` with the signature and the docstring that these flags give it."""
    run.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [inspect.Parameter(f.name, _KEYWORD, default=f.default, annotation=f.kind) for f in flags]
    )
    run.__annotations__ = {flag.name: flag.kind for flag in flags}
    run.__doc__ = "\n".join([about, "", "Args:", *(f"    {flag.name}: {flag.help}" for flag in flags)])
    return run


def outlined(*numbers: float) -> Region:
    """Return the rectangle between two corners, or the polygon through more. Raises MeasureError for other numbers."""
    if len(numbers) < 4 or len(numbers) % 2:
        raise MeasureError(
            f"An area has {len(numbers)} numbers: give X0 Y0 X1 Y1 of a rectangle, or X Y of each corner of a polygon."
        )
    if len(numbers) == 4:
        return Region.rectangle(*numbers)
    return Region.polygon(*zip(numbers[::2], numbers[1::2], strict=True))


def _image_options(
    z_step_um: Um = None,
    pixel_um: Um = None,
    na: Ratio = None,
    wavelength_um: Um = None,
    pattern: Text = None,
    channel: Text = None,
    time: Text = None,
    position: Text = None,
    only: Text = None,
    as_listed: bool = False,
    overrule: bool = False,
    columns: Count = None,
    order: GridOrder = "rows",
    corner: Corner = "top-left",
    mirror: Mirror = "none",
    places: File = None,
) -> ImageOptions:
    """Return the values and choices for images taken elsewhere.

    Args:
        z_step_um: Distance between frames, where SRC does not say it; negative when they were taken downward.
        pixel_um: Size of a pixel on the sample, where SRC does not say it.
        na: Numerical aperture of the objective, in air, where SRC does not say it: bounds the width of focus curves.
        wavelength_um: Of the light, for --na; 0.55 um where it is not given.
        pattern: How files are named, such as r{row}_c{col}_k{k}.tif; {e} where each z was taken in several exposures.
        channel: Name of the channel to take, or its number from 0, where the files have several.
        time: The time to take, where the files have several.
        position: The position to take, where the files have several.
        only: Files to take, by a pattern of their names such as 'img_*.png'.
        as_listed: Take all files in the order given, without a look for gaps, copies and files that are no frames.
        overrule: Take the given values where the files state others.
        columns: Columns of a grid whose fields have running numbers, {n} in the pattern.
        order: How they are numbered; in a snake every second row or column runs back.
        corner: Where they begin.
        mirror: Axes whose direction is reversed, where a grid comes out mirrored.
        places: Table of places: TileConfiguration.txt, MIST, Micro-Manager .pos, or CSV with a header.
    """
    return ImageOptions(
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
        columns=columns,
        order=order,
        corner=corner,
        mirror=mirror,
        places=places,
    )


Images = Annotated[ImageOptions, arg(name="", constructor=_image_options)]
"""Flags of images taken elsewhere."""


def require_sources(src: tuple[Path, ...]) -> None:
    """Raise DatasetError if no image is given."""
    if not src:
        raise DatasetError("There are no images: give a folder of images, a multi-page TIFF or image files.")


def levelling_from(words: tuple[str, ...]) -> Levelling:
    """Return the levelling of `plane`, `form [ORDER]`, `region X0 Y0 X1 Y1` or `points X Y …`.

    No words select the stage's zero. Raises MeasureError for anything else.
    """
    if not words:
        return Levelling()
    method, numbers = words[0], _numbers(words[1:])
    match method, len(numbers):
        case "plane", 0:
            return Levelling(by="plane")
        case "form", 0:
            return Levelling(by="form")
        case "form", 1 if numbers[0].is_integer():
            return Levelling(by="form", order=int(numbers[0]))
        case "region", 4:
            return Levelling(by="region", places=(Region.rectangle(*numbers),))
        case "points", 6:
            at = zip(numbers[::2], numbers[1::2], strict=True)
            return Levelling(by="three points", places=tuple(Region.point(x, y) for x, y in at))
        case _:
            raise MeasureError(
                f"--level cannot be '{' '.join(words)}': use plane, form, form ORDER, region X0 Y0 X1 Y1 or "
                "points X Y X Y X Y."
            )


def _numbers(words: tuple[str, ...]) -> tuple[float, ...]:
    try:
        return tuple(float(word) for word in words)
    except ValueError as fault:
        raise MeasureError(f"--level takes numbers after its first word, not '{' '.join(words)}'.") from fault


def config_of(rig: Path | None) -> RigConfig:
    """Return the rig's configuration; that of the virtual rig without a file."""
    from wafer_viewer.rigs.rig_config import RigConfig, read_config

    return RigConfig() if rig is None else read_config(rig)
