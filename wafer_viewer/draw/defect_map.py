"""The dies of an inspection coloured by how many defects they have, and the defects by class, as SVG for reports. Pure.

Colours are custom properties (``--fault``, ``--good`` …) of whoever shows it; every die bears its number as well.
"""

from __future__ import annotations

import html
from collections import Counter

from wafer_viewer.draw.wafer_map import Frame
from wafer_viewer.model.defects import Inspection
from wafer_viewer.model.die_grid import DieGrid, DieStatus

_LEAST_FOR_NUMBER_PX = 9
_ROW_PX, _NAME_PX, _NUMBER_PX = 20, 90, 36


def defect_map_svg(inspection: Inspection, *, width_px: int = 300, most_height_px: int = 300) -> str:
    """The dies where they lie on the stage; those that were not inspected are dashed. Empty without dies."""
    grid, dies = inspection.grid, inspection.dies
    if grid is None or not dies:
        return ""
    boxes = [grid.outline(die.col, die.row).bounds_um for die in dies]
    x0, y0 = min(box[0] for box in boxes), min(box[1] for box in boxes)
    x1, y1 = max(box[2] for box in boxes), max(box[3] for box in boxes)
    height_px = min(most_height_px, max(40.0, width_px * (y1 - y0) / (x1 - x0)))
    frame, most = Frame((x0, y0, x1, y1), width_px, height_px), max(die.defects or 0 for die in dies)
    drawn = "".join(_die(frame, grid, die, most) for die in dies)
    return (
        f'<svg viewBox="0 0 {width_px} {height_px:.0f}" width="{width_px}" role="img" '
        f'aria-label="Dies by their defects" style="max-width:100%">{drawn}</svg>'
    )


def _die(frame: Frame, grid: DieGrid, die: DieStatus, most: int) -> str:
    x0, y0, x1, y1 = grid.outline(die.col, die.row).bounds_um
    x, y = frame.x(x0), frame.y(y1)
    w, h = max(2.0, (x1 - x0) * frame.scale - 1), max(2.0, (y1 - y0) * frame.scale - 1)
    count = die.defects or 0
    ink = "fault" if count else "good" if die.word == "clean" else "ink3"
    fill = 0.15 + 0.6 * count / most if count else 0.12
    dashes = "" if die.word == "clean" or count else ' stroke-dasharray="3 2"'
    return (
        f"<g><title>Die {html.escape(die.name)}: {html.escape(die.word)}</title>"
        f'<rect x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}" fill="var(--{ink})" '
        f'fill-opacity="{fill:.2f}" stroke="var(--{ink})"{dashes}/>{_number(x, y, w, h, count)}</g>'
    )


def _number(x: float, y: float, w: float, h: float, count: int) -> str:
    if not count or min(w, h) < _LEAST_FOR_NUMBER_PX:
        return ""
    size = min(14.0, 0.6 * min(w, h))
    return (
        f'<text x="{x + w / 2:.1f}" y="{y + h / 2 + 0.35 * size:.1f}" text-anchor="middle" font-size="{size:.1f}" '
        f'fill="var(--ink)">{count}</text>'
    )


def pareto_svg(counts: Counter[str], *, width_px: int = 300) -> str:
    """A bar for each class, the most frequent first, with its number and the share of all up to it."""
    total, high = sum(counts.values()), len(counts) * _ROW_PX
    bars, so_far = "", 0
    for k, (kind, n) in enumerate(counts.most_common()):
        so_far += n
        y, length = k * _ROW_PX, (width_px - _NAME_PX - 2 * _NUMBER_PX) * n / counts.most_common(1)[0][1]
        bars += (
            f'<text x="0" y="{y + 14}" font-size="12" fill="var(--ink)">{html.escape(kind)}</text>'
            f'<rect x="{_NAME_PX}" y="{y + 4}" width="{length:.1f}" height="{_ROW_PX - 8}" fill="var(--fault)"/>'
            f'<text x="{_NAME_PX + length + 6:.1f}" y="{y + 14}" font-size="12" fill="var(--ink)">{n}</text>'
            f'<text x="{width_px}" y="{y + 14}" font-size="12" text-anchor="end" fill="var(--ink3)">'
            f"{100 * so_far / total:.0f} %</text>"
        )
    label = "Defects by class, the most frequent first; the share of all up to each"
    return f'<svg viewBox="0 0 {width_px} {high}" width="{width_px}" role="img" aria-label="{label}">{bars}</svg>'
