"""Which focus measure sees most: false heights at equal completeness, on the truth scenes of dies beside trenches.

    PYTHONPATH=. python tests/bench/bench_focus_measures.py [--window 9] [--keep-light FOLDER]

Of each layout the pixels with the greatest lead over their rival are kept, the same share for every measure; a height
more than a step (4 um) off is false. No other gate, no cleaning. Also the error on a tilted textured plane.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.truth.layouts import TUNING, Taken, take
from tests.truth.scenes import SCENES
from tests.truth.views import Camera, Optics, stack_of
from wafer_viewer.model.recipe import Recipe
from wafer_viewer.model.stack import FieldStack
from wafer_viewer.reconstruct.focus import FOCUS_MEASURES
from wafer_viewer.reconstruct.peak import Peaks
from wafer_viewer.reconstruct.prepare import prepare
from wafer_viewer.reconstruct.search import search_field
from wafer_viewer.reconstruct.tune import settle

KEPT = (0.5, 0.6, 0.7, 0.8, 1.0)
FALSE_UM = 4.0
BORDER_PX = 20


def main() -> None:
    parser = argparse.ArgumentParser(description="Which focus measure sees most.")
    parser.add_argument("--window", type=int, default=9)
    parser.add_argument("--keep-light", type=Path, default=None, help="a folder where the light of the scenes is kept")
    given = parser.parse_args()
    report_false(given.window, given.keep_light)
    report_plane(given.window)


def report_false(window: int, keep_light: Path | None) -> None:
    print(f"false heights (%) among the {', '.join(f'{k:.0%}' for k in KEPT)} of the pixels that lead most")
    rows: dict[str, list[NDArray[np.float64]]] = {name: [] for name in FOCUS_MEASURES}
    for layout in TUNING.values():
        taken = take(layout, keep_in=keep_light)
        for measure, shares in rows.items():
            shares.append(false_shares(taken, searched(taken.stack, measure, window)))
            print(f"{layout.name} {measure:14s} {in_percent(shares[-1])}", flush=True)
    for measure, shares in rows.items():
        print(f"mean {measure:14s} {in_percent(np.mean(shares, axis=0))}")


def report_plane(window: int) -> None:
    """Noise of a third of a grey level, without shot noise."""
    scene = SCENES["plane"](5, (256, 256))
    truth_um, inner = scene.truth_um, (slice(BORDER_PX, -BORDER_PX),) * 2
    for step_um in (4.0, 2.0, 1.0):
        z_um = np.arange(truth_um.min() - 20, truth_um.max() + 20, step_um)
        stack = stack_of(scene, Optics(0.28), z_um, Camera(full_well_e=None), 5)
        for measure in FOCUS_MEASURES:
            error = (searched(stack, measure, window).z_um - truth_um)[inner]
            right = error[np.abs(error) <= max(FALSE_UM, step_um)]
            rmse = np.sqrt(np.mean(right**2))
            print(
                f"plane, step {step_um:g} um, {measure:14s} RMSE {rmse:.3f} um, {1 - right.size / error.size:.2%} false"
            )


def searched(stack: FieldStack, measure: str, window: int) -> Peaks:
    frames = prepare(stack)
    return search_field(frames, settle(frames, Recipe(focus_measure=measure, window=window)).search)


def false_shares(taken: Taken, peaks: Peaks) -> NDArray[np.float64]:
    false = np.abs(peaks.z_um - taken.scene.truth_um) > FALSE_UM
    order = np.argsort(np.where(peaks.at_end, -np.inf, peaks.lead), axis=None)[::-1]
    ranked = false.ravel()[order]
    return np.array([ranked[: round(share * ranked.size)].mean() for share in KEPT])


def in_percent(shares: NDArray[np.float64]) -> str:
    return "  ".join(f"{100 * share:5.2f}" for share in shares)


if __name__ == "__main__":
    main()
