"""A session that stands still and holds comparisons of its surface: with the one before an etch, raw with cleaned."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace

import numpy as np

from tests.browser.recording import Recording, done
from tests.browser.sessions.seen_session import SeenSession
from tests.support.page_stand_in import height_map
from wafer_viewer.model.surface.comparison import Align, Change, Comparison, ComparisonFace, Registration, SurfaceName
from wafer_viewer.model.surface.height_map import HeightMap
from wafer_viewer.session.state.snapshot import Compared
from wafer_viewer.session.surface.comparison_job import ComparisonController

BUMP = slice(200, 260), slice(120, 210)
CHANGE = Change(
    n_points=301_784, mean_um=0.016, median_um=0.0, sq_um=0.19, lowest_um=-0.41, highest_um=2.27, limit_um=0.22,
    changed_fraction=0.013, gained_um3=4970.0, lost_um3=180.0,
)  # fmt: skip
ALIGNED = Registration(
    by="images", x_um=5.991, y_um=-3.986, turn_mrad=-0.01, z_um=-1.0, tilt_x_mrad=0.5, u_xy_um=0.045,
    u_turn_mrad=0.21, u_z_um=0.001, u_tilt_mrad=0.007, levelled=True, residual_um=0.064, overlap_fraction=0.979,
)  # fmt: skip
FIRST, AFTER, GOLDEN = (SurfaceName(path=f"/data/L2231-W07{name}.wafer") for name in ("", "-after", "-golden"))
RAW, CLEANED = (SurfaceName(path=FIRST.path, heights=heights) for heights in ("raw", "cleaned"))


def comparisons() -> tuple[Compared, ...]:
    pairs = ((FIRST, AFTER, ALIGNED), (RAW, CLEANED, Registration()))
    return tuple(
        Compared(n, f"difference-{n}", Comparison(number=n, first=a, second=b, registration=r, change=CHANGE), n)
        for n, (a, b, r) in enumerate(pairs, 1)
    )


class ComparedSession(SeenSession):
    """Two comparisons; the faces of both are drawn alike."""

    def __init__(self) -> None:
        super().__init__()
        self.change(comparisons=comparisons())
        self.comparing = _Comparing(ComparisonController, self._done, "comparing.")
        surfaces = self.shelf.surfaces
        surfaces |= _faces(surfaces[0])


class _Comparing(Recording):
    def choices(self, show: int = 0) -> tuple[tuple[SurfaceName, SurfaceName], ...]:
        return (FIRST, AFTER), (FIRST, GOLDEN), (RAW, CLEANED)

    def begin(
        self, first: SurfaceName, second: SurfaceName, align: Align = "auto", keep_z: bool = False
    ) -> Future[int]:
        return done(1)


def _faces(whole: HeightMap) -> dict[int, HeightMap]:
    """What is painted of a comparison, by the numbers below 0 that the painter is asked with."""
    off = np.random.default_rng(2).normal(0, 0.08, whole.shape)
    off[BUMP] += 4
    place = whole.pixel_um, whole.x0_um, whole.y0_um
    second = height_map(whole.z_um + off, *place)
    gap = np.full((whole.shape[0], 40), np.nan)
    return {
        -ComparisonFace.DIFFERENCE: height_map(off + 0 * whole.z_um, *place),
        -ComparisonFace.FIRST: replace(whole),
        -ComparisonFace.SECOND: second,
        -ComparisonFace.BESIDE: height_map(np.concatenate([whole.z_um, gap, second.z_um], axis=1), *place),
    }
