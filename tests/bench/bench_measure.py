"""How long each tool takes to answer on a large stitched surface, at a place as people draw it and over all of it.

    python tests/bench/bench_measure.py [--quick]

A made-up wafer of 165 million points (--quick: 4 million). Seconds of the processor are given beside those of the
clock: the first do not grow where the machine does other work as well. Then three goals on a map of 44 million points,
as large as the paper's gauge blocks: the plane of the whole (fitted to a million of its pixels), a step between two
areas of 800 x 800 pixels and between its halves, texture of 1000 x 1000 pixels; the best of three.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

from tests.bench.big_mosaic import BLOCKS_PX, PIXEL_UM, WAFER_PX, big_dataset
from tests.bench.harness import met, read_options, show, took
from wafer_viewer.measure.base.levelled_surface import Levelled, datum
from wafer_viewer.measure.registry import measured
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.measurement.measuring_tool import ToolName
from wafer_viewer.model.measurement.tool_options import Datum, Levelling
from wafer_viewer.model.measurement.tools import TOOLS
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import replace
from wafer_viewer.model.surface.height_map import Mosaic, Provenance
from wafer_viewer.store.dataset.dataset import Dataset

QUICK_PX = 2048
CALIBRATION = Calibration(
    pixel_um=PIXEL_UM, u_pixel_um=4e-4, u_z_scale=5e-4, made="2026-01-01", due="2099-01-01", against="a step block"
)
DRAWN_SHARE = 0.02
"""Of the surface's width: a region as people draw it."""


def main() -> None:
    quick = read_options(__doc__).quick
    surface = Dataset.open(big_dataset(QUICK_PX if quick else WAFER_PX)).result().mosaic()
    rows, cols = surface.shape
    print(f"{rows * cols / 1e6:.0f} million points, {surface.levels} levels")
    zeros = list(_zeros(surface))
    show("A zero for the whole surface", ["heights from", "s", "s of the processor"], zeros)
    flat = Levelled(surface, datum(surface, Levelling(by="form")))
    for title, share in (("Drawn", DRAWN_SHARE), ("Over nearly all of it", 0.9)):
        lines = [
            [TOOLS[tool].title, *_timed(partial(measured, flat, tool, at, True))]
            for tool, at in _places(surface, share).items()
        ]
        show(f"{title}, heights over the form", ["tool", "s", "s of the processor"], lines)
    _goals(QUICK_PX if quick else BLOCKS_PX)


class Calibrated(Levelled):
    """A surface that is read as it is, with a calibration, so that budgets are made too."""

    @property
    def provenance(self) -> Provenance:
        return replace(self.surface.provenance, calibration=CALIBRATION)


def _goals(side_px: int) -> None:
    surface = Calibrated(Dataset.open(big_dataset(side_px)).result().mosaic(), Datum())
    x, y, width = _middle(surface)
    area, million = 800 * surface.pixel_um, 1000 * surface.pixel_um
    areas = tuple(_square(x + side * 0.75 * area, y, 0.999 * area) for side in (-1, 1))
    halves = tuple(_square(x + side * width / 4, y, 0.45 * width) for side in (-1, 1))
    asked: tuple[tuple[str, float, Callable[[], object]], ...] = (
        ("Plane of the whole", 1.5, partial(datum, surface, Levelling(by="plane"))),
        ("Step, 800 x 800 px", 2.0, partial(measured, surface, "step", areas, True)),
        ("Step, half and half", 2.0, partial(measured, surface, "step", halves, True)),
        ("Texture, 1 Mpx", 0.5, partial(measured, surface, "texture", (_square(x, y, 0.999 * million),), True)),
    )
    lines: list[list[str]] = []
    for what, goal_s, work in asked:
        times = min((_timed(work) for _ in range(3)), key=lambda each: each[0])
        lines.append([what, *times, f"{goal_s:g}", met(float(times[0]), goal_s)])
    rows, cols = surface.shape
    show(f"{rows * cols / 1e6:.0f} million points", ["what", "s", "s of the processor", "goal, s", ""], lines)


def _zeros(surface: Mosaic) -> Iterator[list[str]]:
    x, y, side = _middle(surface)
    corners = ((x - side / 3, y), (x + side / 3, y), (x, y + side / 3))
    for levelling in (
        Levelling(by="three points", places=tuple(Region.point(*at) for at in corners)),
        Levelling(by="plane"),
        Levelling(by="region", places=(_square(x, y, 0.9 * side),)),
        Levelling(by="form"),
    ):
        yield [levelling.by, *_timed(partial(datum, surface, levelling))]


def _places(surface: Mosaic, share: float) -> dict[ToolName, tuple[Region, ...]]:
    x, y, width = _middle(surface)
    side = share * width
    whole = _square(x, y, side)
    halves = tuple(_square(x + shift * side, y, 0.45 * side) for shift in (-0.25, 0.25))
    ends = tuple(Region.point(x + shift * side, y) for shift in (-0.5, 0.5))
    return {
        "profile": (Region.line(x - side / 2, y, x + side / 2, y),),
        "point": ends[:1],
        "distance": ends,
        "step": halves,
        "groove": (Region.line(x - side / 2, y, x + side / 2, y),),
        "angle": halves,
        "radius": (Region.circle(x, y, side / 3),),
        "volume": (whole,),
        "flatness": (whole,),
        "texture": (whole,),
    }


def _middle(surface: Mosaic) -> tuple[float, float, float]:
    """The middle of the surface and its shorter side, in um."""
    rows, cols = surface.shape
    x_um, y_um = surface.x0_um + cols / 2 * surface.pixel_um, surface.y0_um - rows / 2 * surface.pixel_um
    return x_um, y_um, min(rows, cols) * surface.pixel_um


def _square(x_um: float, y_um: float, side_um: float) -> Region:
    return Region.rectangle(x_um - side_um / 2, y_um - side_um / 2, x_um + side_um / 2, y_um + side_um / 2)


def _timed(work: Callable[[], object]) -> list[str]:
    """Seconds by the clock and of the processor, or why there is no answer."""
    try:
        return [f"{seconds:.2f}" for seconds in took(work).both]
    except MeasureError as fault:
        return ["-", f"{str(fault)[:48]}…"]


if __name__ == "__main__":
    main()
