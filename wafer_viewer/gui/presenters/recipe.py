"""Presentation of a recipe: names of its options, values chosen from the data, notes. Pure functions."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import viser

from wafer_viewer.draw.number_format import digits_of_u, number, with_unit
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.surface.recipe import READY_RECIPES, Recipe

READY = {"Default": "default", "The paper's method": "paper"}
OWN = "Custom"
"""Name of a recipe that matches no preset."""
DRIFT = {"Correct": "correct", "Leave": "none"}
FOCUS = {"Log-Laplacian": "log_laplacian", "Tenengrad": "tenengrad", "SML": "sml", "GLV": "glv"}
WINDOW = {"From the data": "auto", **{f"{n} px": n for n in range(3, 27, 2)}}
PEAK = {"Blur law": "blur_law", "Tent": "tent", "Gaussian": "gaussian", "Highest frame": "argmax"}
SECOND_WINDOW = {"Must agree": True, "Not tested": False}
EDGES = {"Measure the rims": "rims", "Only what agrees": "band", "Not tested": "none"}
SMOOTHING = {
    "Sigma filter": "sigma_filter",
    "Switching median": "switching_median",
    "Levy, guided": "guided",
    "Levy, literal": "literal",
    "None": "none",
}
OUTLIERS = {"Lattice": "lattice", "Cloud": "cloud", "None": "none"}
FILL = {"Small gaps": "small_gaps", "All gaps": "all", "None": "none"}
BELIEVES_ALL = "Every peak is accepted: neither the second window nor walls are tested."
_FLIES = ("literal", "guided")


def name_of(names: Mapping[str, Any], value: object) -> str:
    """Return the display name of an option."""
    return next(name for name, key in names.items() if key == value)


def ready_name(recipe: Recipe) -> str:
    """Return the display name of a recipe: its preset, else ``Custom``."""
    return next((name for name, key in READY.items() if READY_RECIPES[key] == recipe), OWN)


def accepts_all_peaks(recipe: Recipe) -> bool:
    """Return whether every peak is accepted, so that neither second window nor edges are tested."""
    return recipe.min_confidence == 0


def summary(recipe: Recipe) -> str:
    """Describe a recipe in one line."""
    return f"{name_of(FOCUS, recipe.focus_measure)} · window {_px(recipe.window)} · {name_of(PEAK, recipe.peak)}"


def chosen_by_data(asked: Recipe, settled: Recipe) -> list[tuple[str, str]]:
    """Return name and value of each setting that is auto in `asked` and fixed in `settled`, in order of use."""
    return [(name, told(settled)) for name, get, told in _LEFT_TO_DATA if get(asked) == "auto" != get(settled)]


def notes(sentences: Iterable[str], sign: Any = viser.Icon.INFO_CIRCLE, tone: str = "") -> str:
    """Return the notes; those that differ only in numbers are folded into one. `tone`: '' or 'attention'."""
    kinds: dict[str, list[str]] = {}
    for sentence in sentences:
        kinds.setdefault(re.sub(r"\d[\d.]*", "0", sentence), []).append(sentence)
    said = "".join(_kind(alike, sign) for alike in kinds.values())
    return said and f'<div class="wv-notes {tone}">{said}</div>'


def _kind(alike: list[str], sign: Any) -> str:
    first, *others = (html.safe(_sentence(text)) for text in alike)
    if others:
        more = "".join(f"<p>{other}</p>" for other in others)
        first = f"<details><summary>{first} <u>{len(others)} more like it</u></summary>{more}</details>"
    return f"<div>{html.icon(sign, 15)}<div>{first}</div></div>"


def _sentence(text: str) -> str:
    """Format a note: micro signs, multiplication signs, a full stop."""
    return re.sub(r"(?<![.\w])x(?=\d)", "× ", html.with_micro_sign(text)).rstrip(".") + "."


def _px(window: int | str) -> str:
    return "from the data" if isinstance(window, str) else with_unit(window, 0, "px")


def _figures(value: float | str) -> str:
    """Format a number to two significant digits."""
    return number(float(value), digits_of_u(float(value)))


def _flight(recipe: Recipe) -> str:
    scale = _figures(recipe.levy.alpha)
    return f"{scale} µm" if recipe.levy.mode == "literal" else f"{scale} × distance to the guide"


_LEFT_TO_DATA: tuple[tuple[str, Callable[[Recipe], Any], Callable[[Recipe], str]], ...] = (
    ("Camera noise, gain", lambda r: r.noise.gain_counts, lambda r: f"{_figures(r.noise.gain_counts)} counts"),
    ("Camera noise, floor", lambda r: r.noise.floor_counts2, lambda r: f"{_figures(r.noise.floor_counts2)} counts²"),
    ("Window", lambda r: r.window, lambda r: _px(r.window)),
    ("Width of a focus curve", lambda r: r.focus_width_um, lambda r: with_unit(float(r.focus_width_um), 1)),
    ("Confidence from", lambda r: r.min_confidence, lambda r: number(float(r.min_confidence), 2)),
    (
        "Smoothing takes for noise",
        lambda r: None if r.levy.mode == "none" else r.levy.n_sigma,
        lambda r: f"up to {number(float(r.levy.n_sigma), 1)} σ",
    ),
    ("Scale of the Lévy flights", lambda r: r.levy.alpha if r.levy.mode in _FLIES else None, _flight),
    (
        "Rounds of smoothing",
        lambda r: None if r.levy.mode == "none" else r.levy.iterations,
        lambda r: number(float(r.levy.iterations), 0),
    ),
    (
        "Outlier threshold",
        lambda r: None if r.outliers.mode == "none" else r.outliers.floor_um,
        lambda r: f"over {with_unit(float(r.outliers.floor_um), 2)}",
    ),
)
"""Settings that may be auto: display name, getter (None if unused), formatter of the value."""
