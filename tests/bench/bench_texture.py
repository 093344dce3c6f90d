"""How long the texture of a region takes, all families, without and with filters, whole and with holes.

    python tests/bench/bench_texture.py [--quick]

A made-up surface in memory; one thread. Seconds by the clock and of the processor: the first grow where the machine
does other work as well. Peers are compared with by texture_peers.py.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.ndimage import gaussian_filter

from tests.bench.big_mosaic import BLOCKS_PX, big_dataset
from tests.bench.harness import read_options, show, took
from tests.bench.texture_peers import PIXEL_UM, as_map
from wafer_viewer.measure.texture.areal_texture import texture
from wafer_viewer.measure.texture.roughness import roughness
from wafer_viewer.model.region import Region
from wafer_viewer.store.dataset.dataset import Dataset

ROUNDS = 5
QUICK_PX, QUICK_SIDE_PX = 2048, 400
Timed = Callable[[Callable[[], object]], str]
SETTINGS: dict[str, dict[str, float]] = {
    "no filter": {},
    "form of order 4": {"form_order": 4},
    "S 2.5 um": {"s_filter_um": 2.5},
    "S 2.5, L 80 um": {"s_filter_um": 2.5, "l_filter_um": 80.0},
    "S 10, L 180 um, form 4": {"s_filter_um": 10.0, "l_filter_um": 180.0, "form_order": 4},
}


def main() -> None:
    quick = read_options(__doc__).quick
    side_px = QUICK_SIDE_PX if quick else 1024
    timed = partial(_timed, rounds=1 if quick else ROUNDS)
    rng = np.random.default_rng(1)
    z_um = 5 * gaussian_filter(rng.normal(size=(side_px, side_px)), 4)
    holed = np.where(rng.random(z_um.shape) < 0.1, np.nan, z_um)
    # A ridge along one direction: looking for where it ends is the most that the spatial parameters ask for.
    grating = np.broadcast_to(np.sin(np.arange(side_px) / 3), z_um.shape) + 0.01 * z_um
    side_um = (side_px - 1) * PIXEL_UM
    face, line = Region.rectangle(0, 0, side_um, side_um), Region.line(0, side_um / 2, side_um, side_um / 2)
    rows = [
        [name, *(timed(partial(texture, as_map(z), face, **options)) for z in (z_um, holed, grating))]
        for name, options in SETTINGS.items()
    ]
    title = f"Texture of {side_px**2 / 1e6:.2f} million pixels, s"
    show(title, ["settings", "whole", "10 % holes", "grating"], rows)
    _on_a_stored_surface(QUICK_PX if quick else BLOCKS_PX, side_px, timed)
    surface = as_map(z_um)
    lines = [[f"lambda-c {um:g} um", timed(partial(roughness, surface, line, lambda_c_um=um))] for um in (25.0, 50.0)]
    show("Roughness of a line across it, s", ["settings", ""], lines)


def _on_a_stored_surface(whole_px: int, side_px: int, timed: Timed) -> None:
    """The same as an operator has it: a part of a stitched surface, read from disk."""
    surface = Dataset.open(big_dataset(whole_px)).result().mosaic()
    half_um = (side_px - 1) / 2 * surface.pixel_um
    face = Region.rectangle(-half_um, -half_um, half_um, half_um)
    rows = [[name, timed(partial(texture, surface, face, **options))] for name, options in SETTINGS.items()]
    show(f"The same part of a stored surface of {whole_px**2 / 1e6:.0f} million points, s", ["settings", ""], rows)


def _timed(work: Callable[[], object], rounds: int) -> str:
    """The best of some rounds, after one to load what is loaded once."""
    work()
    done = took(work, rounds)
    return f"{done.clock_s:.3f} ({done.processor_s:.3f})"


if __name__ == "__main__":
    main()
