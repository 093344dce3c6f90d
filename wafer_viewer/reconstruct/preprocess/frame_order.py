"""Order of the frames in which each follows smoothly from those beside it, where the given one looks like z jitter.

Frames that are not in the order of their z differ from what those beside them predict, as frames at a wrong z do. The
difference is less in the right order. What is left there is jitter: a stage that vibrates leaves as much in any order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.numerics.frame_sequence import named_orders
from wafer_viewer.reconstruct.preprocess.frame_jitter import DIFFERS, BlockMeans, Floats, frame_jitter

MOSTLY, PARTLY = 0.3, 0.7
"""Shares of the differences that remain in another order: up to one it explains them, up to the other if jitter goes.

In 37 scenes of tests/truth/unseen.py (seeds 100 to 139) the best order that names give leaves .61 and more of a right
one's differences; where frames were turned, cut or sorted as text, 78 of 111 leave less than .3.
"""
JITTER_GOES = 1 / 3
"""Largest jitter in another order, as a share of that in the given one, at which it is gone."""
LESS_ALIKE = 2.0
"""How much less alike, at least, frames are that another order parts than those that stay together.

In 18 scenes of tests/truth/unseen.py (seeds 100 to 117) the best order that names give parts frames that are 0.9 times
as unlike in the median where the given one is right; where it was cut or sorted as text, about 50 times.
"""
_WORST, _MOST_MOVES, _LEAST_GAIN = 4, 40, 0.02
"""Frames that are moved at once, those that differ most; number of moves; and the least share that a move gains."""

Orders = NDArray[np.intp]


def order_without_jitter(
    means: BlockMeans | None, z_um: Floats, step_um: float, jitter_um: float
) -> tuple[int, ...] | None:
    """Return an order of the frames, from 0, that explains what they differ by; None without one.

    jitter_um: of the given order as far as it is told, which must be gone then; 0 to try the orders that names give
    only, which takes milliseconds.
    """
    if means is None:
        return None
    contrast = means.contrast
    products = contrast.astype(np.float64) @ contrast.T
    best = _best_order(products) if jitter_um else _order_like_names(products)
    given = np.arange(len(contrast))
    was, now = _differences(products, np.stack([given, best]))
    left_um = frame_jitter(means.in_order(best), z_um, step_um).sigma_um
    if now >= (PARTLY if left_um < JITTER_GOES * jitter_um else MOSTLY) * was or not _parts_unlike(products, best):
        return None
    rises = 2 * np.count_nonzero(np.diff(best) > 0) >= len(best) - 1
    return tuple((best if rises else best[::-1]).tolist())


def _parts_unlike(products: Floats, order: Orders) -> bool:
    """Return whether frames that the order parts are less alike than those that stay beside each other.

    An order may also differ less because it moves the frames that change most, those about the focus, to the ends,
    where nothing is predicted.
    """
    power = np.diag(products)
    if not power.all():
        return False
    unlike = 1 - 2 * np.diag(products, 1) / (power[:-1] + power[1:])
    stays = np.abs(np.diff(np.argsort(order))) == 1
    if stays.all():
        return False
    return not stays.any() or bool(unlike[~stays].mean() > LESS_ALIKE * np.median(unlike[stays]))


def _order_like_names(products: Floats) -> Orders:
    """Return the order with the least differences among those that names give."""
    named = np.array(list(named_orders(len(products))))
    return named[_differences(products, named).argmin()]


def _best_order(products: Floats) -> Orders:
    """Return the order with the least differences that is found from the given one, one of names, and likeness.

    On a level sample frames above and below the focus are alike: an order that mixes them differs less than one with
    a single frame in a wrong place, but not less than the right one.
    """
    given = np.arange(len(products))
    starts = given, _order_like_names(products), _along_likeness(products)
    found = np.array([_improved(products, one) for one in starts])
    return found[_differences(products, found).argmin()]


def _differences(products: Floats, orders: Orders) -> Floats:
    """Return the summed squared differences of the inner frames from those beside them, [order]; of scalar products."""
    n, width = orders.shape[1], len(DIFFERS)
    total = np.zeros(len(orders))
    for apart in range(width):
        weights = np.zeros(n - apart)
        for first in range(width - apart):
            weights[first : n - width + 1 + first] += (1 + (apart > 0)) * DIFFERS[first] * DIFFERS[first + apart]
        total += products[orders[:, : n - apart], orders[:, apart:]] @ weights
    return total


def _worst(products: Floats, order: Orders) -> list[int]:
    """Return the places in an order whose frames differ most from those beside them."""
    seven = np.lib.stride_tricks.sliding_window_view(order, len(DIFFERS))
    differs = np.einsum("nab,a,b->n", products[seven[:, :, None], seven[:, None, :]], DIFFERS, DIFFERS)
    return (np.argsort(-differs, kind="stable")[:_WORST] + len(DIFFERS) // 2).tolist()


def _along_likeness(products: Floats) -> Orders:
    """Return an order in which frames stand beside those that are most alike."""
    power = np.diag(products)
    apart = power[:, None] + power - 2 * products
    order = [int(np.argmin(power))]
    left = set(range(len(power))) - set(order)
    while left:
        order.append(min(left, key=lambda k: apart[order[-1], k]))
        left.remove(order[-1])
    return np.array(order)


def _improved(products: Floats, order: Orders) -> Orders:
    """Return an order with single frames moved and swapped as long as the differences are less for it."""
    least = _differences(products, order[None])[0]
    for _ in range(_MOST_MOVES):
        tried = np.array(list(_moves(order, _worst(products, order))))
        sums = _differences(products, tried)
        if sums.min() > (1 - _LEAST_GAIN) * least:
            break
        order, least = tried[sums.argmin()], sums.min()
    return order


def _moves(order: Orders, worst: Sequence[int]) -> Iterator[Orders]:
    """Yield orders with one of the worst frames elsewhere, or swapped with another."""
    for n in worst:
        rest = np.delete(order, n)
        for k in range(len(order)):
            yield np.insert(rest, min(k, len(rest)), order[n])
            swapped = order.copy()
            swapped[[n, k]] = swapped[[k, n]]
            yield swapped
