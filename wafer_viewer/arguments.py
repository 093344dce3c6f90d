"""The kinds of arguments that commands take, as the command line names them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from wafer_viewer.model.errors import DatasetError

PlanFile = Annotated[Positional[Path], arg(metavar="PLAN.toml")]
DatasetFolder = Annotated[Positional[Path], arg(metavar="NAME.wafer")]
Folder = Annotated[Positional[Path], arg(metavar="FOLDER")]
Source = Annotated[Positional[Path], arg(metavar="SRC")]
Sources = Annotated[Positional[tuple[Path, ...]], arg(metavar="SRC ...")]
Out = Annotated[Path, arg(aliases=("-o",), metavar="FILE")]
Um = Annotated[float | None, arg(metavar="UM")]
File = Annotated[Path | None, arg(metavar="FILE")]
Count = Annotated[int | None, arg(metavar="N")]
Text = Annotated[str | None, arg(metavar="TEXT")]
Rectangle = Annotated[tuple[float, float, float, float], arg(metavar="X0 Y0 X1 Y1")]
Place = Annotated[tuple[float, float], arg(metavar="X Y")]
NewFile = Annotated[Positional[Path], arg(metavar="FILE")]


def require_sources(src: tuple[Path, ...]) -> None:
    """Raises DatasetError where no image is named."""
    if not src:
        raise DatasetError("There are no images: give a folder of images, a multi-page TIFF or image files.")
