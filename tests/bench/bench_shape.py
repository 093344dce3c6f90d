"""How far off edges, kerfs, dies, circles, chips and bumps are measured, and how often their U covers the truth.

    python tests/bench/bench_shape.py [--quick] [--runs N]

Pictures with known edges: 120 grey values from dark to bright, blurred by a Gaussian of 1.2 px where no other blur is
named, noise of 3 grey values, rounded to 8 bits; bumps 15 um high with 0.1 um of noise correlated over 3 px on a die
tilted by 2 mrad. Simulated, the pixel and the z scale known without error. Lengths of pictures in pixels, those of
bumps in um. The goals: a mean error of 0.02 px, and U (k = 2) covers 93 to 97 % of the runs.
A chip's depth is the median of three search lines, which its round end makes smaller; it has no goal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from tests.bench.harness import met, percent, read_options, show, took
from tests.support.bumped_surface import bumped
from tests.support.made_up_pictures import all_of, chipped_edge, covered, die, disc, edge, kerf, strip
from wafer_viewer.measure.edges.straight_edges import DieEdges, die_edges, find_edge, find_edge_in_any_direction
from wafer_viewer.measure.tools.chipping import edge_depths
from wafer_viewer.measure.tools.circle import find_circle
from wafer_viewer.measure.tools.coplanarity import coplanarity
from wafer_viewer.measure.tools.kerf import kerf_edges

RUNS, QUICK_RUNS = 400, 40
FEWER = 8
"""Of a case that takes longer: one run in so many."""
GOAL_PX, COVER = 0.02, (0.93, 0.97)
Answer = tuple[float, float | None]
"""Error and expanded uncertainty, None where none is evaluated."""


def twice(u: float | None) -> float | None:
    return None if u is None else 2 * u


def an_edge(seed: int, blur_px: float = 1.2, correlation_px: float = 0.0) -> Answer:
    at = float(np.random.default_rng(seed).uniform(-0.5, 0.5))
    line = find_edge(strip(edge(at, seed=seed, blur_px=blur_px, correlation_px=correlation_px))).line
    return -float(line.off(at, 0.0)), twice(line.u_um(float(line.along(at, 0.0))))


def a_kerf(seed: int) -> Answer:
    off = float(np.random.default_rng(seed).uniform(-0.5, 0.5))
    edges = kerf_edges(strip(kerf(38.4, off_px=off, seed=seed)))
    return edges.width_um - 38.4, twice(edges.u_um)


def of_a_die(answer: Callable[[DieEdges], Answer]) -> Callable[[int], Answer]:
    return lambda seed: answer(die_edges(strip(die(seed=seed))))


def a_circle(radius_px: float) -> Callable[[int], Answer]:
    def measure(seed: int) -> Answer:
        x, y = np.random.default_rng(seed).uniform(-1, 1, 2)
        found = find_circle(strip(disc(radius_px, x, y, seed=seed)), 0.0, 0.0, 1.3 * radius_px)
        return found.radius_um - radius_px, twice(found.u_radius_um)

    return measure


def a_chip(answer: Callable[[float, float], float]) -> Callable[[int], Answer]:
    """Of a half disc of 9 px radius that is missing: depth and area go into the answer."""

    def measure(seed: int) -> Answer:
        across, found = find_edge_in_any_direction(strip(chipped_edge(slope=0.0, seed=seed)))
        chips = edge_depths(across, found, inwards=True).chips(4.0)
        return answer(chips[0].depth_um, chips[0].area_um2), None

    return measure


def of_bumps(side: int) -> Callable[[int], Answer]:
    def measure(seed: int) -> Answer:
        made = bumped(side, seed=seed)
        found = coplanarity(made.surface, all_of(made.surface)).coplanarity
        return found.value_um - made.range_um, found.expanded_um

    return measure


CASES: dict[str, tuple[Callable[[int], Answer], int, str]] = {
    "edge, place": (an_edge, 1, "px"),
    "edge blurred by 0.8 px": (lambda seed: an_edge(seed, blur_px=0.8), 1, "px"),
    "edge blurred by 3 px": (lambda seed: an_edge(seed, blur_px=3.0), 1, "px"),
    "edge, noise correlated over 3 px": (lambda seed: an_edge(seed, correlation_px=3.0), 1, "px"),
    "edge, noise correlated over 8 px": (lambda seed: an_edge(seed, correlation_px=8.0), 1, "px"),
    "kerf of 38.4 px, width": (a_kerf, 1, "px"),
    "die of 700.3 x 512.7 px at 1.3 degrees, width": (
        of_a_die(lambda e: (e.size_um("left", "right") - 700.3, twice(e.u_size_um("left", "right")))),
        FEWER,
        "px",
    ),
    "  height": (
        of_a_die(lambda e: (e.size_um("lower", "upper") - 512.7, twice(e.u_size_um("lower", "upper")))),
        FEWER,
        "px",
    ),
    "  rotation": (of_a_die(lambda e: (e.rotation_deg - 1.3, e.u_angle_deg)), FEWER, "deg"),
    "circle of 12 px, radius": (a_circle(12.0), 1, "px"),
    "circle of 30.3 px, radius": (a_circle(30.3), 1, "px"),
    "chip of 9 px, depth": (a_chip(lambda depth, _: depth - 9), FEWER, "px"),
    "  area, share": (a_chip(lambda _, area: area / (np.pi * 81 / 2) - 1), FEWER, ""),
    "coplanarity of 3 x 3 bumps": (of_bumps(3), FEWER, "um"),
    "coplanarity of 10 x 10 bumps, one 3 um taller": (of_bumps(10), 5 * FEWER, "um"),
}
"""What is measured, in one of how many runs, in which unit."""


def rows(runs: int) -> Iterator[list[str | float | int | None]]:
    for name, (measure, fewer, unit) in CASES.items():
        n = max(2, runs // fewer)
        done = took(lambda one=measure, n=n: [one(seed) for seed in range(n)])
        errors, expanded = zip(*done.result, strict=True)
        each_ms = 1e3 * done.clock_s / n
        mean, sd = float(np.mean(errors)), float(np.std(errors))
        known = None not in expanded
        share = covered(errors, expanded) if known else float("nan")
        goal = met(abs(mean), GOAL_PX + 3 * sd / np.sqrt(n)) if unit == "px" and known else "-"
        u = float(np.mean(expanded)) if known else None
        yield [name, unit, n, f"{mean:+.5f}", sd, u, percent(share), goal, each_ms]


def main() -> None:
    given = read_options(__doc__, runs=int)
    runs = given.runs or (QUICK_RUNS if given.quick else RUNS)
    show(
        f"Shapes, simulated; goal: mean error {GOAL_PX} px, U covers {COVER[0]:.0%} to {COVER[1]:.0%}",
        "what | unit | runs | mean error | sd | U | covered % | mean | ms",
        list(rows(runs)),
    )


if __name__ == "__main__":
    main()
