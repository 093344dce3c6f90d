"""Order of the frames of a focus stack as the images themselves support it.

Sharpness rises and falls once at a place while the focus passes its height. An order in which it does so at most places
is supported; one in which it rises and falls several times, and another order of the same images does not, is
contradicted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

TILES, TILE_PX, LEAST_TILE_PX = 8, 48, 16
"""Places looked at along each side of the frame, their size in px, and the least size."""
CONTRADICTED = 0.5
"""Share of its dips that another order must leave, for the given one to be contradicted.

In 16 scenes of tests/truth/unseen.py (seeds 9000000 to 9000015) the best other order leaves .82 to 1 of the right
order's dips; of orders that begin in the middle, .02 to .9.
"""
LEAST_DIPS = 0.02
"""Mean depth of dips, as a share of the range of sharpness, which noise makes in a right order."""
FEWEST_FRAMES, FEWEST_PLACES = 6, 9
"""Below these another order is better by chance."""


@dataclass(frozen=True, slots=True)
class SupportedOrder:
    """Another order of the frames than the given one. order: indices of the given frames.

    dips, dips_given: mean depth of the dips of sharpness, as a share of its range, in this order and in the given one.
    """

    order: tuple[int, ...]
    dips: float
    dips_given: float


def contradicting_order(sharpness: NDArray[np.float64]) -> SupportedOrder | None:
    """Return the order that frames support where it contradicts theirs, else None.

    Orders that arise from names are tried: beginning in the middle, one side of the focus reversed, both sides
    interleaved, numbers sorted as text.

    Parameters
    ----------
    sharpness : ndarray [k, place]
        Sharpness of each frame at each place, over 0; see `place_sharpness`.

    Returns
    -------
    SupportedOrder or None
        The order with the shallowest dips, if they are less than `CONTRADICTED` of those in the given order.
    """
    given = _dips(sharpness)
    few = len(sharpness) < FEWEST_FRAMES or sharpness.shape[1] < FEWEST_PLACES
    if few or given < LEAST_DIPS:
        return None
    dips, order = min((_dips(sharpness[order]), order) for order in named_orders(len(sharpness)))
    return SupportedOrder(tuple(order), dips, given) if dips < CONTRADICTED * given else None


def place_sharpness(image: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.float64]:
    """Return the sharpness of a frame at places spread over it, independent of its brightness.

    Parameters
    ----------
    image : ndarray [row, col]
        A frame.

    Returns
    -------
    ndarray [place]
        Root mean square of the Laplacian over the mean, of pixels binned by two.
    """
    n_rows, n_cols = (max(1, min(TILES, size // LEAST_TILE_PX)) for size in image.shape)
    places = [
        _tile(image, (row + 0.5) / n_rows, (col + 0.5) / n_cols, n_rows, n_cols)
        for row in range(n_rows)
        for col in range(n_cols)
    ]
    return np.array([_sharpness(tile) for tile in places])


def _tile(image: NDArray[np.generic], down: float, right: float, n_rows: int, n_cols: int) -> NDArray[np.float64]:
    rows, cols = image.shape
    half_rows, half_cols = min(TILE_PX, rows // n_rows) // 2, min(TILE_PX, cols // n_cols) // 2
    row, col = int(down * rows), int(right * cols)
    return image[row - half_rows : row + half_rows, col - half_cols : col + half_cols].astype(np.float64)


def _sharpness(tile: NDArray[np.float64]) -> float:
    rows, cols = (size // 2 * 2 for size in tile.shape)
    binned = tile[:rows, :cols].reshape(rows // 2, 2, cols // 2, 2).mean((1, 3)) / (tile.mean() + 1e-6)
    inner = binned[1:-1, 1:-1]
    laplacian = 4 * inner - binned[:-2, 1:-1] - binned[2:, 1:-1] - binned[1:-1, :-2] - binned[1:-1, 2:]
    return float(np.sqrt(np.mean(laplacian**2))) if laplacian.size else 0.0


def _dips(sharpness: NDArray[np.float64]) -> float:
    """Return the mean depth of dips beside the peak, over the places where sharpness changes most."""
    span = np.ptp(sharpness, axis=0)
    relative = span / (sharpness.mean(0) + 1e-12)
    used = relative > np.median(relative) / 2
    if not used.any():
        return 0.0
    curves, span = sharpness[:, used], span[used]
    rising = np.maximum.accumulate(curves)
    falling = np.maximum.accumulate(curves[::-1])[::-1]
    envelope = np.where(np.arange(len(curves))[:, None] <= curves.argmax(0), rising, falling)
    return float(np.mean((envelope - curves) / span))


def named_orders(n: int) -> Iterator[list[int]]:
    """Yield the orders that undo those which names give to frames."""
    frames = list(range(n))
    for at in range(1, n):
        yield frames[at:] + frames[:at]
    for at in range(2, n - 1):
        yield frames[:at][::-1] + frames[at:]
        yield frames[:at] + frames[at:][::-1]
        yield frames[at:] + frames[:at][::-1]
    yield frames[::2][::-1] + frames[1::2]
    yield frames[1::2][::-1] + frames[::2]
    for first in (0, 1):
        as_text = sorted(range(first, n + first), key=str)
        yield [as_text.index(number) for number in range(first, n + first)]
