"""A session that stands still, with a surface to be seen and clicked, and made-up frames and focus curves for it."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any

import numpy as np
from scipy import ndimage

from tests.browser.recording import done
from tests.browser.sessions.surface_session import SurfaceSession
from tests.support.page_stand_in import COLS, PIXEL_UM, ROWS, grid, height_map, job_and_plan, snapshot_of
from wafer_viewer.model.surface.focus_curve import FocusCurve, Rival, Verdict

Z_UM = tuple(float(z) for z in np.arange(-6.0, 54.0))
DIE_UM, TRENCH_UM = 30.0, 2.0


class SeenSession(SurfaceSession):
    """One field with a die and a trench beside it. `answers`: what the next questions come to instead of the usual."""

    def __init__(self) -> None:
        job, plan = job_and_plan(grid(1, 1))
        whole = _surface()
        super().__init__(snapshot_of(whole, plan, job), {0: whole, 1: whole})
        self.answers: list[Future[FocusCurve]] = []

    def focus_curve(self, x_um: float, y_um: float, show: int = 0) -> Future[FocusCurve]:
        if self.answers:
            return self.answers.pop(0)
        return done(a_focus_curve(x_um, y_um))

    def frame_near(self, field: int, z_um: float) -> Any:
        """The nearer to the die's height, the sharper the picture."""
        texture = np.random.default_rng(1).normal(140, 90, (ROWS, COLS))
        return ndimage.gaussian_filter(texture, 0.6 + abs(z_um - DIE_UM) / 8).clip(0, 255).astype(np.uint8)


def a_focus_curve(x_um: float, y_um: float, measured: bool = True) -> FocusCurve:
    z = np.array(Z_UM)
    focus = np.exp2(-((z - DIE_UM) ** 2) / 40) + 0.04
    focus += (0.34 if measured else 0.93) * np.exp2(-((z - TRENCH_UM) ** 2) / 30)
    texts = ("gate", "question", "score", "limit", "unit", "passed")
    verdicts = tuple(
        Verdict(**dict(zip(texts, verdict, strict=True)))
        for verdict in (
            ("clipped", "Is the window free of pixels that are too bright?", 0.0, 0.3, "share of the window", True),
            ("texture", "Is there texture to focus on?", 4.4, 1.29, "powers of two", True),
            ("range", "Does the peak lie within the sweep?", 0.0, 0.0, "1 at an end", True),
            (
                "rival",
                "Does the peak stand over its rivals?",
                1.53 if measured else 0.1,
                0.64,
                "powers of two",
                measured,
            ),
        )
    )
    windows = Verdict(
        gate="windows", question="Does a window twice as wide see the same height?", unit="um",
        score=0.31 if measured else 28.02, limit=None, passed=True, note="This gate is off.",
    )  # fmt: skip
    return FocusCurve(
        field=1,
        row=ROWS // 2,
        col=COLS // 2,
        x_um=x_um,
        y_um=y_um,
        focus_measure="tenengrad",
        window=13,
        z_um=Z_UM,
        focus=tuple((focus / focus.max()).tolist()),
        grey=(140,) * len(Z_UM),
        peak_z_um=DIE_UM + 0.31,
        height_um=DIE_UM + 0.31 if measured else None,
        origin="measured" if measured else "ambiguous peak",
        confidence=0.65 if measured else 0.07,
        rivals=(Rival(z_um=TRENCH_UM, share=0.36 if measured else 0.93),),
        verdicts=(*verdicts, windows),
        simulated=True,
    )


def _surface() -> Any:
    """A die on the left, with a dome, over a trench on the right; something in the die is not measured."""
    y, x = np.mgrid[:ROWS, :COLS]
    z = np.where(x < 0.7 * COLS, DIE_UM, TRENCH_UM) + np.random.default_rng(1).normal(0, 0.15, (ROWS, COLS))
    z += np.maximum(0, 16 * (1 - ((x - 220) ** 2 + (y - 180) ** 2) / 110**2))
    z[380:440, 240:330] = np.nan
    return height_map(z, PIXEL_UM, -(COLS - 1) / 2 * PIXEL_UM, (ROWS - 1) / 2 * PIXEL_UM)
