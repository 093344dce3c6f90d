"""How right the heights are, on stacks made by rays through the aperture, whose truth is known.

    python tests/bench/accuracy.py [--quick] [--only SECTION ...]
    python tests/bench/accuracy.py --scenes N --from SEED [--measures MEASURE ...] [--each]
    python tests/bench/accuracy.py --path-traced N --from SEED [--measures MEASURE ...] [--each]

Beside ours stand the paper's method step by step, and other people's programs on the same stacks. A
height is false when it is more than a step of 4 um off. --quick: small frames and few of them, at most a minute;
otherwise some ten minutes. Light once traced is kept in the folder of temporary files, so that a run that was stopped
goes on where it was. --scenes: N scenes drawn by seed from a wide distribution instead, by two renderers, the false
share of each against a limit of its own; a second or two a scene. --path-traced: N scenes by the path tracer Mitsuba 3
(``pip install mitsuba``, and LLVM 17 or newer), two or three minutes of a core each. Tuning sees seeds below 1000.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tests.bench.dies import show_dies
from tests.bench.gauge_step import show_step
from tests.bench.harness import met, percent, read_options, run_sections, show, some_of, took
from tests.bench.peers import PEERS
from tests.bench.recipes import BASELINE, DEFAULT, MEASURES, METHODS, Method, ungated
from tests.bench.rig_scenes import show_rig
from tests.bench.seen import seen
from tests.bench.unseen_scenes import show_path_traced, show_scenes
from tests.truth.layouts import HELD_OUT, PILLBOX, TUNING, Layout, Taken
from tests.truth.unseen import FIRST_REPORTED_SEED
from tests.truth.views import Camera
from wafer_viewer.measure.truth_comparison import Quality, quality
from wafer_viewer.model.acquisition.focus_stack import FieldStack
from wafer_viewer.model.spec import replace as changed
from wafer_viewer.model.surface.focus_measures import focus_measures
from wafer_viewer.model.surface.recipe import Recipe
from wafer_viewer.reconstruct.field_pipeline import reconstruct
from wafer_viewer.reconstruct.focus.peak_interpolation import PEAKS

FALSE_UM = 4.0
DISTANCES_PX = (0.0, 2.0, 5.0, 10.0, 20.0, np.inf)
"""Bounds of the bands of distance from an edge."""
STAIR = Layout("stair", PILLBOX, 21, scene="stair")
PLANE = Layout("plane", PILLBOX, 22, Camera(full_well_e=None), scene="plane")
PLANE_SWEEP_UM = 140.0 + np.arange(124.0)
PLANE_GOALS_UM, STAIR_GOAL = {2: 0.08, 4: 0.25}, 0.80


def main() -> None:
    asked = read_options(
        __doc__,
        only=some_of(SECTIONS),
        scenes=int,
        path_traced=int,
        first_seed=FIRST_REPORTED_SEED,
        measures=some_of(MEASURES, [DEFAULT.focus_measure]),
        each=False,
    )
    for judge, count in ((show_scenes, asked.scenes), (show_path_traced, asked.path_traced)):
        if count is not None:
            judge(count, asked.first_seed, asked.measures, asked.each)
            return
    run_sections(SECTIONS, asked)


def stair(quick: bool) -> None:
    """The paper's simulated scene."""
    taken = seen(replace(STAIR, name="short stair", settings={"treads": 3}), 128) if quick else seen(STAIR, 320)
    rows, found = [], {}
    surfaces = {name: method(taken.stack) for name, method in METHODS.items()}
    heights = {name: surface.z_um for name, surface in surfaces.items()}
    heights["default, measured pixels"] = surfaces["default"].raw_um
    for name, z_um in heights.items():
        found[name] = quality(z_um, taken.scene.truth_um, FALSE_UM)
        rows.append(quality_row(name, found[name]))
    show("Simulated stair, treads 40 um apart: what each method calls its surface", QUALITY_HEADER, rows)
    plain = found[BASELINE]
    show(
        "Change over plain Tenengrad argmax, %",
        ("method", "RMSE", "Corr", "PSNR"),
        [(name, *changes(plain, other)) for name, other in found.items() if other is not plain]
        + [("paper, TEN to TEN_LW (Table 2)", "-40.7", "+7.5", "+38.2")],
    )
    for name in ("default, measured pixels", "default"):
        better = 1 - found[name].rmse_um / plain.rmse_um
        print(f"{name}: RMSE {percent(better)} % under plain Tenengrad (goal 80 {met(better, STAIR_GOAL, True)})")


QUALITY_HEADER = ("method", "RMSE um", "Corr", "PSNR dB", "SSM um2", "bias um", "kept %", "false %", "RMSE of true um")


def quality_row(name: str, found: Quality) -> tuple[str | float, ...]:
    return (
        name,
        found.rmse_um,
        f"{found.corr:.4f}",
        found.psnr_db,
        found.ssm_um2,
        found.bias_um,
        percent(found.completeness_fraction),
        percent(found.false_fraction, 2),
        found.true_rmse_um,
    )


def changes(plain: Quality, other: Quality) -> tuple[str, ...]:
    """RMSE, Corr and PSNR of another method against the plain one, as the paper gives them."""
    pairs = ((plain.rmse_um, other.rmse_um), (plain.corr, other.corr), (plain.psnr_db, other.psnr_db))
    return tuple(f"{100 * (new / old - 1):+.1f}" for old, new in pairs)


def plane(quick: bool) -> None:
    """A tilted textured plane, noise of a third of a grey level: every measure, every peak, every step."""
    taken = seen(PLANE, 96 if quick else 256, PLANE_SWEEP_UM)
    steps = (2, 4) if quick else (1, 2, 4, 8)
    rows: list[tuple[str | float, ...]] = []
    for measure in focus_measures():
        for peak in PEAKS:
            recipe = changed(ungated(measure), window=9, peak=peak)
            rows.append((f"{measure}, {peak}", *(plane_error(taken, recipe, n).rmse_um for n in steps)))
    defaults = [plane_error(taken, DEFAULT, n) for n in steps]
    rows.append(("default, kept pixels", *(found.rmse_um for found in defaults)))
    rows.append(("  of them kept, %", *(percent(found.completeness_fraction) for found in defaults)))
    show(
        "Plane tilted by 0.1, noise of a third of a grey level: RMSE in um at a step of",
        ("measure, peak (window 9)", *(f"{n} um" for n in steps)),
        rows,
    )
    for n, found in zip(steps, defaults, strict=True):
        if n in PLANE_GOALS_UM:
            goal = PLANE_GOALS_UM[n]
            print(f"default at {n} um: {found.rmse_um:.3f} um (goal {goal} um {met(found.rmse_um, goal)})")


def plane_error(taken: Taken, recipe: Recipe, every: int) -> Quality:
    """The error of the raw heights from every so many frames, 10 px of the border aside."""
    stack = taken.stack
    frames = slice(1, None, every)
    thin = FieldStack(stack.field, stack.images[frames], stack.z_um[frames], stack.present[frames], stack.pixel_um)
    inner = slice(10, -10)
    z_um = reconstruct(thin, recipe).z_raw_um[inner, inner]
    return quality(z_um, taken.scene.truth_um[inner, inner], float(every))


def edges(quick: bool) -> None:
    """The error against the distance from a wall."""
    layouts = [TUNING["A"]] if quick else [TUNING["A"], TUNING["R"], HELD_OUT["A-turned17"]]
    for layout in layouts:
        taken = seen(layout, 160 if quick else 320)
        rows = []
        for name in ("default", BASELINE):
            raw_um, scene = METHODS[name](taken.stack).raw_um, taken.scene
            for low, high in pairwise(DISTANCES_PX):
                inside = (scene.edge_distance_px >= low) & (scene.edge_distance_px < high)
                band = quality(raw_um, np.where(inside, scene.truth_um, np.nan), FALSE_UM)
                shares = percent(band.completeness_fraction), percent(band.false_fraction, 2)
                where = f"{low:g} to {high:g} px"
                rows.append((f"{name}, {where}", *shares, band.rmse_um, band.bias_um))
        header = ("method, distance from a wall", "kept %", "false %", "RMSE um", "bias um")
        show(f"Error against distance from a wall, {layout.name}: {layout.about}", header, rows)


def peers(quick: bool) -> None:
    """Other people's programs on the same stacks."""
    layouts = (TUNING["A"],) if quick else (STAIR, replace(PLANE, name="plane-shot", camera=Camera()), TUNING["A"])
    for layout in layouts:
        taken = seen(layout, 160 if quick else 320)
        rows = [our_row(name, taken, method) for name, method in METHODS.items()]
        rows += [peer_row(name, taken) for name in PEERS]
        header = ("program", "kept %", "false %", "RMSE um", "picture PSNR dB", "ms a frame and Mpx", "gives")
        show(f"Programs on one stack, {layout.name}: one thread", header, rows)


def our_row(name: str, taken: Taken, method: Method) -> tuple[str | float, ...]:
    method(taken.stack)
    made = took(lambda: method(taken.stack))
    found = made.result
    return (f"ours, {name}", *result_row(taken, found.raw_um, found.all_in_focus, made.clock_s), "heights")


def peer_row(name: str, taken: Taken) -> tuple[str | float, ...]:
    peer = PEERS[name]
    if peer.missing:
        return (name, *(None,) * 5, peer.missing)
    found = peer.run(taken.stack)
    z_um = taken.stack.z_um[found.frame].astype(np.float32)
    return (name, *result_row(taken, z_um, found.all_in_focus, found.seconds), "frame numbers")


def result_row(taken: Taken, z_um: NDArray, picture: NDArray, seconds: float) -> tuple[str | float, ...]:
    found = quality(z_um, taken.scene.truth_um, FALSE_UM)
    noise = np.sqrt(np.mean((picture.astype(float) - taken.sharp_grey) ** 2))
    ms = 1e3 * seconds / (taken.stack.images.size / 1e6)
    shares = percent(found.completeness_fraction), percent(found.false_fraction, 2)
    return (*shares, found.rmse_um, 20 * float(np.log10(255 / noise)), ms)


def dies(quick: bool) -> None:
    """Dies beside bright trenches, layouts of the tuning and others apart."""
    side = 160 if quick else 320
    tuning = {"A": TUNING["A"]} if quick else TUNING
    others = {"A-turned17": HELD_OUT["A-turned17"]} if quick else HELD_OUT
    show_dies("layouts of the tuning", [seen(layout, side) for layout in tuning.values()], ablate=True)
    show_dies("other layouts", [seen(layout, side) for layout in others.values()], ablate=False)


SECTIONS: dict[str, Callable[[bool], None]] = {
    "stair": stair,
    "dies": dies,
    "plane": plane,
    "step": show_step,
    "edges": edges,
    "peers": peers,
    "rig": show_rig,
}

if __name__ == "__main__":
    main()
