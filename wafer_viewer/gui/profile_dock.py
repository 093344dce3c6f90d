"""The bottom panel: the profile as a curve in µm, live while its handles move. The scene makes room for it."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.draw.numbers import number, with_unit
from wafer_viewer.draw.ticks import round_step
from wafer_viewer.gui import html
from wafer_viewer.gui.bottom import BottomPanel
from wafer_viewer.gui.kit import Cell
from wafer_viewer.gui.measure_panel import MeasurePanel
from wafer_viewer.draw.colours import PROFILE_COLOURS
from wafer_viewer.gui.measure_words import averaging
from wafer_viewer.gui.page import Page
from wafer_viewer.gui.style import PROFILE_PX, palette
from wafer_viewer.gui.view import View
from wafer_viewer.model.findings import Profile, ProfileCurve
from wafer_viewer.session.state import Snapshot

MOST_POINTS = 1500
"""More than the plot has pixels; longer curves are thinned by their extremes."""
MOST_PIECES, PIECES_STEP = 40, 8
"""Most measured pieces that are drawn apart, and the steps in which their number grows: each is a series."""
PLOT_MARGIN_PX = 48


class ProfileDock:
    """Head with the figures, and the plot."""

    def __init__(self, page: Page, measure: MeasurePanel) -> None:
        self._page, self._measure = page, measure
        self._drawn: object = None
        self._panel = BottomPanel(page, "profile")
        with self._panel.tab:
            self._head = Cell(page.gui)
            self._body = page.gui.add_folder(None)
            self._plot: Any = None
            self._plot_kind = False, 0

    def show(self, snapshot: Snapshot, view: View) -> None:
        """Bring the curve up to date."""
        if not self._panel.show(view):
            return
        answer = self._measure.answer
        profile = answer.finding if isinstance(answer.finding, Profile) else None
        self._head.show(_head(profile, answer.problem))
        if answer.curve is not None and (answer.curve, view.dark) != self._drawn:
            self._drawn = (answer.curve, view.dark)
            self._draw(answer.curve, view.dark)

    def _draw(self, curve: ProfileCurve, dark: bool) -> None:
        distance, z = thinned(curve.distance_um, curve.z_um, MOST_POINTS)
        data = (distance, *pieces(z))
        scales: Any = {"x": {"time": False, "range": _x_range(distance)}, "y": {"range": y_range(z)}}
        if self._plot is not None and self._plot_kind == (dark, len(data)):
            self._plot.data = data
            self._plot.scales = scales
            return
        if self._plot is not None:
            self._plot.remove()
        self._plot_kind = dark, len(data)
        line: Any = {"label": "z", "stroke": PROFILE_COLOURS[0], "width": 1.8, "points": {"show": False}}
        with self._body:
            self._plot = self._page.gui.add_uplot(
                data=data,
                series=({}, *[line] * (len(data) - 1)),
                scales=scales,
                axes=(_axis("Distance along the profile, µm", 34, dark), _axis("z, µm", 56, dark)),
                legend={"show": False},
                height=PROFILE_PX - PLOT_MARGIN_PX,
                padding=(8, 18, 0, 0),
                cursor={"drag": {"x": True, "y": False}},
            )


def thinned(
    x: NDArray[np.float64], z: NDArray[np.float64], most: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A curve with at most `most` points that keeps every peak, valley and gap.

    Each stretch is shown by its lowest and its highest point; one without a measured point stays a gap (NaN).
    """
    if len(z) <= most:
        return x, z
    stretches = most // 2
    edges = np.linspace(0, len(z), stretches + 1).astype(int)
    xs, zs = np.empty(2 * stretches), np.empty(2 * stretches)
    for k, (first, last) in enumerate(itertools.pairwise(edges)):
        part = z[first:last]
        picked = (
            np.sort([np.nanargmin(part), np.nanargmax(part)])
            if np.isfinite(part).any()
            else np.array([0, len(part) - 1])
        )
        xs[2 * k : 2 * k + 2], zs[2 * k : 2 * k + 2] = x[first + picked], part[picked]
    return xs, zs


def pieces(z: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """The measured pieces of a curve, each alone in a series and NaN elsewhere: within one a gap is drawn over.

    Where there are more than `MOST_PIECES`, the narrowest gaps are drawn over; empty series make a round number.
    """
    good = np.flatnonzero(np.isfinite(z))
    jumps = np.flatnonzero(np.diff(good) > 1)
    widest = np.sort(jumps[np.argsort(-np.diff(good)[jumps], kind="stable")][: MOST_PIECES - 1])
    runs = np.split(good, widest + 1) if good.size else []
    apart = [np.full(len(z), np.nan) for _ in range(max(1, -(-len(runs) // PIECES_STEP)) * PIECES_STEP)]
    for piece, run in zip(apart, runs, strict=False):
        piece[run] = z[run]
    return apart


def y_range(z: NDArray[np.float64]) -> tuple[float, float]:
    """Round ends around the heights that stay put while a handle moves a little."""
    if not np.isfinite(z).any():
        return -1.0, 1.0
    low, high = float(np.nanmin(z)), float(np.nanmax(z))
    step = round_step(max((high - low) / 4, 0.05))
    return step * np.floor(low / step - 0.15), step * np.ceil(high / step + 0.15)


def _x_range(distance: NDArray[np.float64]) -> tuple[float, float]:
    return (0.0, float(distance[-1])) if len(distance) > 1 else (0.0, 1.0)


def _axis(label: str, size_px: int, dark: bool) -> Any:
    colours, font = palette(dark), "12px Inter, Segoe UI, sans-serif"
    return {
        "label": label,
        "size": size_px,
        "labelSize": 20,
        "font": font,
        "labelFont": font,
        "stroke": colours["ink2"],
        "grid": {"stroke": colours["line"], "width": 1},
        "ticks": {"stroke": colours["line"], "width": 1, "size": 5},
    }


def _head(profile: Profile | None, problem: str) -> str:
    if profile is None:
        text = html.micro(problem) or "The curve comes as soon as the line lies on the surface."
        return f'<div class="wv-dock"><b>Profile</b><span class="dim">{html.safe(text)}</span></div>'
    sign = html.chip(f"P{profile.number or ''}", PROFILE_COLOURS[0])
    line = f"{with_unit(profile.length_um, 0)} long, {averaging(profile)} wide"
    pt = f'<span>{sign}&ensp;Pt <b>{with_unit(profile.pt.value_um, 2)}</b>&ensp;<span class="dim">{line}</span></span>'
    rise = f"Δx <b>{number(profile.length_um, 1)}</b>&ensp;Δz <b>{with_unit(profile.rise.value_um, 2, signed=True)}</b>"
    return f'<div class="wv-dock"><b>Profile</b>{pt}<span class="wv-end">{rise}</span></div>'
