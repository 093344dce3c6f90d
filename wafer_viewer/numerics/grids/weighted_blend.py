"""Weighted blending of fields into a window, one field after the other.

Each loop over a row writes one array, so that the compiler can rule out aliasing and vectorise it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from wafer_viewer.numerics.jit import Float32s, Greys, Int, Real, UInt8s, lean_kernel, lean_part

_MEASURED = 0
"""Code of a measured height, `Origin.MEASURED`."""
_NOT_COVERED = 10
"""Code of a pixel that no field covers, `Origin.NOT_COVERED`."""
_LEAST_TRUST = np.float32(1e-4)
"""Smallest weight by confidence, of a height without any."""
_LEAST_SHARE = np.float32(0.01)
"""Smallest weight by agreeing neighbours, of a height without any."""


class Blended(NamedTuple):
    """Layers of the window that the fields are blended into, all [row, col]."""

    z: Float32s
    raw: Float32s
    confidence: Float32s
    origin: UInt8s
    overlap: Float32s
    u: Float32s


class BlendPiece(NamedTuple):
    """Layers of one field over a piece of the window, in the window's pixels, with blend weights.

    The weight of a height is its belief times the weights of its row and column.
    """

    z: Float32s
    raw: Float32s
    confidence: Float32s
    origin: UInt8s
    u: Float32s
    belief: Float32s
    row_weights: Float32s
    col_weights: Float32s


class Tally(NamedTuple):
    """Accumulators of a piece of the window: total weight, and range of the raw heights."""

    weight: Float32s
    lowest: Float32s
    highest: Float32s


@lean_kernel
def blend_weights(layer: Float32s, confidence: Float32s, row: Int, col: Int, limit: Real, out: Float32s) -> None:
    """Compute the weights of a field's heights for a piece whose pixel (0, 0) is nearest to (row, col) of the field.

    Product of the squared confidence, because errors grow as it falls, and the fraction of the eight neighbours within
    `limit` of the height, because false heights are isolated. Never zero.
    """
    last_row, last_col = layer.shape[0] - 1, layer.shape[1] - 1
    for r in range(out.shape[0]):
        i = row + r
        above, below = max(i - 1, 0), min(i + 1, last_row)
        first, end = (1 if col == 0 else 0), (out.shape[1] - 1 if col + out.shape[1] > last_col else out.shape[1])
        for x in range(out.shape[1]):
            out[r, x] = np.float32(1)
        a, b = layer[above, col + first - 1 : col + end + 1], layer[i, col + first - 1 : col + end + 1]
        c = layer[below, col + first - 1 : col + end + 1]
        _count_near(a, b, c, np.float32(limit), out[r, first:end])
        _scale_by_confidence(confidence[i, col : col + out.shape[1]], out[r])


@lean_kernel
def accumulate(
    piece: BlendPiece, limit: Real, tally: Tally, scratch: Float32s, window: Blended, row: Int, col: Int
) -> None:
    """Blend one more field into a piece of the window that starts at (row, col).

    A measured height replaces a filled one. Of two that differ by more than `limit`, the one with the larger weight is
    used; others are averaged by their weights, and so are their standard uncertainties: no correlation of two fields
    makes the mean less certain than that. scratch: [2, columns].
    """
    n = piece.col_weights.size
    new, share = scratch[0], scratch[1]
    gross = np.float32(limit)
    for r in range(piece.row_weights.size):
        z, raw = window.z[row + r, col : col + n], window.raw[row + r, col : col + n]
        origin, weight = window.origin[row + r, col : col + n], tally.weight[r]
        _weigh(piece.belief[r], piece.row_weights[r], piece.col_weights, new)
        _share(z, piece.z[r], weight, new, origin, piece.origin[r], gross, share)
        _mix(z, piece.z[r], share)
        _mix(raw, piece.raw[r], share)
        _mix(window.confidence[row + r, col : col + n], piece.confidence[r], share)
        _mix(window.u[row + r, col : col + n], piece.u[r], share)
        _update_origins(origin, piece.origin[r], share)
        _update_weights(weight, new, share)
        _extend_range(tally.lowest[r], tally.highest[r], piece.raw[r], window.overlap[row + r, col : col + n])


@lean_kernel
def blend_grey(grey: Float32s, row_weights: Float32s, col_weights: Float32s, weight: Float32s, total: Float32s) -> None:
    """Blend the grey of one more picture into that of a piece with its accumulated weight."""
    for r in range(row_weights.size):
        _mix_grey(total[r], grey[r], row_weights[r], col_weights, weight[r])
        for x in range(col_weights.size):
            weight[r, x] += row_weights[r] * col_weights[x]


@lean_kernel
def round_grey(grey: Float32s, out: Greys, row: Int, col: Int) -> None:
    """Round the grey of a piece to integers and write it to `out` from (row, col) on."""
    n = grey.shape[1]
    for r in range(grey.shape[0]):
        _round(grey[r], out[row + r, col : col + n])


@lean_part
def _count_near(a: Float32s, b: Float32s, c: Float32s, limit: Real, out: Float32s) -> None:
    """Write the fraction of near neighbours plus a minimum; the input rows start one pixel before `out`."""
    for x in range(out.size):
        z = b[x + 1]
        vertical = np.float32(abs(a[x] - z) <= limit) + np.float32(abs(a[x + 1] - z) <= limit)
        sideways = np.float32(abs(b[x] - z) <= limit) + np.float32(abs(b[x + 2] - z) <= limit)
        under = np.float32(abs(c[x] - z) <= limit) + np.float32(abs(c[x + 1] - z) <= limit)
        corners = np.float32(abs(a[x + 2] - z) <= limit) + np.float32(abs(c[x + 2] - z) <= limit)
        out[x] = np.float32(0.125) * (vertical + sideways + under + corners) + _LEAST_SHARE


@lean_part
def _scale_by_confidence(confidence: Float32s, belief: Float32s) -> None:
    for x in range(belief.size):
        belief[x] *= confidence[x] * confidence[x] + _LEAST_TRUST


@lean_part
def _weigh(belief: Float32s, row_weight: Real, col_weights: Float32s, out: Float32s) -> None:
    for x in range(out.size):
        out[x] = row_weight * col_weights[x] * belief[x]


@lean_part
def _share(
    old: Float32s,
    new: Float32s,
    old_weight: Float32s,
    new_weight: Float32s,
    old_origin: UInt8s,
    new_origin: UInt8s,
    limit: Real,
    share: Float32s,
) -> None:
    """Write the weight of the new height in the blend: 0 if it does not count, 1 if it replaces the old one."""
    for x in range(share.size):
        has_new, has_old = new[x] == new[x], old[x] == old[x]
        measured, was_measured = new_origin[x] == _MEASURED, old_origin[x] == _MEASURED
        off = abs(new[x] - old[x]) > limit
        wins = (measured & (not was_measured)) | ((measured == was_measured) & off & (new_weight[x] > old_weight[x]))
        joins = (measured == was_measured) & (not off)
        part = new_weight[x] / (old_weight[x] + new_weight[x]) if joins else np.float32(0)
        share[x] = np.float32(0) if not has_new else (np.float32(1) if wins | (not has_old) else part)


@lean_part
def _mix(old: Float32s, new: Float32s, share: Float32s) -> None:
    """Mix old and new by `share`; NaN is used only if it is the only value."""
    for x in range(old.size):
        mixed = old[x] + share[x] * (new[x] - old[x]) if share[x] < 1 else new[x]
        old[x] = mixed if share[x] > 0 else old[x]


@lean_part
def _update_origins(origin: UInt8s, codes: UInt8s, share: Float32s) -> None:
    for x in range(origin.size):
        origin[x] = codes[x] if (share[x] > 0) | (origin[x] == _NOT_COVERED) else origin[x]


@lean_part
def _update_weights(weight: Float32s, new: Float32s, share: Float32s) -> None:
    for x in range(weight.size):
        remaining = weight[x] if share[x] < 1 else np.float32(0)
        weight[x] = remaining + (new[x] if share[x] > 0 else np.float32(0))


@lean_part
def _extend_range(lowest: Float32s, highest: Float32s, raw: Float32s, overlap: Float32s) -> None:
    """Extend the range of raw heights; with two or more of them it is the overlap difference."""
    for x in range(raw.size):
        top = raw[x] if raw[x] > highest[x] else highest[x]
        bottom = raw[x] if raw[x] < lowest[x] else lowest[x]
        overlap[x] = top - bottom if (raw[x] == raw[x]) & (lowest[x] == lowest[x]) else overlap[x]
    for x in range(raw.size):
        lowest[x] = raw[x] if (raw[x] < lowest[x]) | (lowest[x] != lowest[x]) else lowest[x]
    for x in range(raw.size):
        highest[x] = raw[x] if (raw[x] > highest[x]) | (highest[x] != highest[x]) else highest[x]


@lean_part
def _mix_grey(total: Float32s, grey: Float32s, row_weight: Real, col_weights: Float32s, weight: Float32s) -> None:
    for x in range(total.size):
        new = row_weight * col_weights[x]
        total[x] += new / (weight[x] + new) * (grey[x] - total[x])


@lean_part
def _round(grey: Float32s, out: Greys) -> None:
    for x in range(out.size):
        out[x] = np.int32(grey[x] + np.float32(0.5))
