"""Picture around an alignment corner, and the stage position of a click on it. Pure functions."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.draw.surface.pixel_patch import greys, patch_url
from wafer_viewer.gui.widgets import html
from wafer_viewer.model.acquisition.alignment import Alignment
from wafer_viewer.model.acquisition.devices import Overview
from wafer_viewer.model.job.job import Job

SIDE_UM = 300.0
"""Side of the picture: shows a corner, the adjacent streets, and the possible misplacement of a wafer."""
Place = tuple[float, float]
_CLICK = (
    "const f=event.detail?[event.offsetX/this.clientWidth,event.offsetY/this.clientHeight]:[0.5,0.5];"
    "this.dataset.k=this.dataset.at+';'+f.join(';');"
)


@dataclass(frozen=True, slots=True)
class Square:
    """Displayed part of the overview: upper left corner on the stage, and side, in µm."""

    left_um: float
    top_um: float
    side_um: float

    def at(self, across: float, down: float) -> Place:
        """Return the stage position at fractions of the picture's width and height."""
        return self.left_um + across * self.side_um, self.top_um - down * self.side_um

    def shares(self, place_um: Place) -> tuple[float, float]:
        """Return a stage position as fractions of the picture's width and height."""
        return (place_um[0] - self.left_um) / self.side_um, (self.top_um - place_um[1]) / self.side_um


def expected_um(job: Job, seen_um: tuple[Place | None, ...], n: int) -> Place:
    """Return the expected stage position of corner n: by the alignment, else by the notch and the marked corners."""
    if job.marks is None:
        return 0.0, 0.0
    lies = job.alignment or Alignment.by_notch(job.sample.notch)
    places = [lies.to_stage(mark.x_um, mark.y_um) for mark in job.marks.places]
    if job.alignment is not None:
        return places[n]
    off = [(s[0] - p[0], s[1] - p[1]) for s, p in zip(seen_um, places, strict=True) if s is not None]
    dx, dy = (sum(d[axis] for d in off) / max(1, len(off)) for axis in (0, 1))
    return places[n][0] + dx, places[n][1] + dy


def square_round(overview: Overview, place_um: Place) -> tuple[Square, int, int, int]:
    """Return the pixel-aligned square around a position: square, row and column of its centre, side in px."""
    side_px = 2 * round(SIDE_UM / overview.pixel_um / 2)
    col = round((place_um[0] - overview.x0_um) / overview.pixel_um)
    row = round((overview.y0_um - place_um[1]) / overview.pixel_um)
    left_um = overview.x0_um + (col - side_px // 2 - 0.5) * overview.pixel_um
    top_um = overview.y0_um - (row - side_px // 2 - 0.5) * overview.pixel_um
    return Square(left_um, top_um, side_px * overview.pixel_um), row, col, side_px


def corner_picture(overview: Overview | None, job: Job, seen_um: tuple[Place | None, ...], n: int) -> str:
    """Return the picture with expected and marked position of the corner; a click picks ``corner-at``."""
    if overview is None or overview.image is None or job.marks is None:
        return html.empty("No picture of the stage:", "drive there and mark", "where the stage stands.")
    expected = expected_um(job, seen_um, n)
    square, row, col, side_px = square_round(overview, expected)
    url = patch_url(overview.image, row, col, side_px, greys(overview.image))
    name = html.safe(f"Click corner {n + 1}: {job.marks.places[n].name}")
    at = f"{n};{square.left_um!r};{square.top_um!r};{square.side_um!r}"
    return (
        f'<div class="wv-corner" aria-label="{name}" title="{name}" data-at="{at}" {_pick()}><img src="{url}" alt="">'
        f"{_cross(square.shares(expected), 'due')}{_cross(square.shares(p), 'seen') if (p := seen_um[n]) else ''}</div>"
    )


def clicked(key: str) -> tuple[int, Place]:
    """Return the corner that a click on the picture marks, and its stage position."""
    n, left, top, side, across, down = key.split(";")
    return int(n), Square(float(left), float(top), float(side)).at(float(across), float(down))


def _pick() -> str:
    """Return attributes as `html.pick`, with the click position in the key; Enter picks the expected position."""
    script = html.safe(_CLICK + html.pick_script("corner-at"))
    keys = "if(event.key==='Enter'||event.key===' '){event.preventDefault();this.click()}"
    return f'data-pick="corner-at" role="button" tabindex="0" onclick="{script}" onkeydown="{keys}"'


def _cross(at: tuple[float, float], kind: str) -> str:
    return f'<i class="{kind}" style="left:{100 * at[0]:.2f}%;top:{100 * at[1]:.2f}%"></i>'
