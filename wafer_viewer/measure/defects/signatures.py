"""Signatures: clusters, scratches, rings and edge concentrations of defects, against defects at random."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.inspection.die_grid import DieGrid
from wafer_viewer.model.inspection.lot import DefectSignature, SignatureKind, WaferDefects
from wafer_viewer.model.region import Point

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.bool_]
LEVEL = 0.01
"""Share of the wafers with defects at random on which any signature is named."""
NEIGHBOURS = (0.5, 0.1, 0.02)
"""Expected numbers of defects within the linking distances if defects lie at random; larger clusters form at 4.5."""
TIGHT = 1
"""Which of these distances links defects to groups that count once for a ring."""
SIMULATIONS, FEW_SIMULATIONS = 999, 399
"""Numbers of random wafers that are compared, and of wafers with many defects."""
MANY, MOST = 2000, 20_000
"""Numbers of defects from which fewer random wafers are compared, and above which none are."""
LEAST_DEFECTS = 5
"""Fewer defects have no signature."""
BINS, WIDEST = 40, 12
"""Number of rings of the same area, and of those in the widest ring that is searched for."""
DOMAIN_POINTS = 200_000
"""Random places by which rings of the same area are made."""
LINE_RATIO, LINE_CHANCE = 4.0, 1e-3
"""Least ratio of the deviations along and across a scratch, and largest probability of it for a round cluster."""
ARC_SPREAD, ARC_SPAN_RAD = 0.1, math.pi / 2
"""Largest relative deviation of the radii of a cluster that is a ring, and its smallest angle."""
EDGE_FROM = 0.9
"""Share of the inspected area within the radius from which a ring is at the edge."""
MOST_RESULTANT = 0.5
"""Largest mean resultant length of the directions in a ring; what lies on one side is none."""


def signatures(wafer: WaferDefects, *, level: float = LEVEL, seed: int = 0) -> tuple[DefectSignature, ...]:
    """Find clusters, scratches, rings and edge concentrations that chance does not explain.

    Parameters
    ----------
    wafer : WaferDefects
        An inspected wafer, or a stack, with dies that were inspected completely.
    level : float, default 0.01
        Probability that any signature is named on a wafer whose defects lie at random.
    seed : int, default 0
        Seed of the random wafers; the same seed gives the same probabilities.

    Returns
    -------
    tuple of DefectSignature
        The least likely first. A probability is that of a signature as clear anywhere on the wafer.

    Raises
    ------
    MeasureError
        If no die was inspected completely, there are over 20 000 defects on them, or `level` is not between 0 and 1.

    Notes
    -----
    Only defects on completely inspected dies count. Random wafers have as many defects, uniform over these dies. Half
    of `level` goes to each of two tests by simulation.

    Rings: the area is divided into 40 rings of the same area around the wafer's centre, or the middle of the dies.
    The ring of up to 12 of them with the most significant excess is compared with that of each random wafer (a scan
    statistic [1]_); a tight group counts as one there. An excess on one side of the centre is no ring, and none is
    searched for where dies were inspected on one side only.

    Clusters: defects are linked within three distances, at which 0.5, 0.1 and 0.02 others are expected. The sizes of
    the groups are compared with the largest one of each random wafer, the three distances together by their smallest
    probability. Random wafers have the ring that was found. A cluster is a scratch if its deviation along is at
    least 4 times that across, which a round cluster of as many defects has in 0.1 % (Mauchly's test [2]_). It is a
    ring if it follows a circle around the centre over at least 90 degrees.

    References
    ----------
    .. [1] M. Kulldorff, "A spatial scan statistic", Communications in Statistics: Theory and Methods 26 (1997),
       1481-1496.
    .. [2] J. W. Mauchly, "Significance test for sphericity of a normal n-variate distribution", Ann. Math. Statist. 11
       (1940), 204-209.
    """
    if not 0 < level < 1:
        raise MeasureError(f"level is {level:g}: it must be between 0 and 1.")
    domain = _Domain.of(wafer)
    xy_um, numbers = domain.places(wafer)
    if len(xy_um) > MOST:
        raise MeasureError(f"There are {len(xy_um)} defects, and random wafers are compared up to {MOST}.")
    if len(xy_um) < LEAST_DEFECTS:
        return ()
    rng = np.random.default_rng(seed)
    rings = _Rings.of(domain, rng)
    null = _RandomWafers.of(domain, _Density.of(xy_um, domain, rings, None), rng)
    ring = rings.test(xy_um, domain, null) if domain.is_around else None
    found_ring = ring if ring is not None and ring.by_chance <= level / 2 and ring.resultant <= MOST_RESULTANT else None
    if found_ring is not None:
        null = _RandomWafers.of(domain, _Density.of(xy_um, domain, rings, found_ring), rng)
    clusters = [one for one in _clusters(xy_um, domain, null.largest) if one.by_chance <= level / 2]
    found = [_of_cluster(one, xy_um, numbers, domain, rings) for one in clusters]
    found += [_of_ring(found_ring, xy_um, numbers, domain, rings)] if found_ring is not None else []
    return tuple(sorted(found, key=lambda one: (one.by_chance, -len(one.numbers))))


# ---------------------------------------------------------------------------------------------------------- inspected


@dataclass(frozen=True, slots=True, eq=False)
class _Domain:
    """Completely inspected dies [n, (col, row)], and centre, in um along the lattice from the corner of die 0,0."""

    grid: DieGrid
    dies: Ints
    center_um: Floats

    @classmethod
    def of(cls, wafer: WaferDefects) -> _Domain:
        inspected, grid = wafer.inspected_dies, wafer.grid
        if grid is None or not inspected:
            raise MeasureError(
                f"{wafer.title} has no completely inspected die: random defects need the inspected area."
            )
        dies = np.array([(die.col, die.row) for die in inspected])
        size = np.array([grid.width_um, grid.height_um])
        corners = dies * np.array([grid.pitch_x_um, grid.pitch_y_um])
        middle = (corners.min(axis=0) + corners.max(axis=0) + size) / 2
        if wafer.center is not None:
            middle = _along(grid, np.array([[wafer.center.x_um, wafer.center.y_um]]))[0]
        return cls(grid, dies, middle)

    @property
    def area_um2(self) -> float:
        """Area of the dies without streets."""
        return len(self.dies) * self.grid.width_um * self.grid.height_um

    @property
    def is_around(self) -> bool:
        """True if dies were inspected in all four quadrants around the centre."""
        pitch = np.array([self.grid.pitch_x_um, self.grid.pitch_y_um])
        size = np.array([self.grid.width_um, self.grid.height_um])
        x, y = (self.dies * pitch + size / 2 - self.center_um).T
        return all(bool(np.any((a * x > 0) & (b * y > 0))) for a in (1, -1) for b in (1, -1))

    def places(self, wafer: WaferDefects) -> tuple[Floats, Ints]:
        """Return places along the lattice and numbers of the defects on the dies."""
        own = np.array([(d.x_um, d.y_um) for d in wafer.defects]).reshape(-1, 2)
        cols, rows, u, v = self.grid.to_die(*own.T)
        inspected = {tuple(die) for die in self.dies.tolist()}
        on = np.array([place in inspected for place in zip(cols.tolist(), rows.tolist(), strict=True)], bool)
        on &= (u >= 0) & (u <= self.grid.width_um) & (v >= 0) & (v <= self.grid.height_um)
        numbers = np.array([defect.number for defect in wafer.defects], np.int64)
        return _along(self.grid, own)[on], numbers[on]

    def random(self, n: int, rng: np.random.Generator) -> Floats:
        """Return so many uniform places."""
        corners = self.dies[rng.integers(len(self.dies), size=n)] * (self.grid.pitch_x_um, self.grid.pitch_y_um)
        return corners + rng.random((n, 2)) * (self.grid.width_um, self.grid.height_um)

    def radii(self, xy_um: Floats) -> Floats:
        """Return distances from the centre."""
        return np.hypot(*(xy_um - self.center_um).T)

    def to_stage(self, xy_um: Floats) -> Point:
        """Return a place in the coordinates of the wafer's defects."""
        x, y = self.grid.to_stage(0, 0, float(xy_um[0]), float(xy_um[1]))
        return Point(x_um=float(x), y_um=float(y))


def _along(grid: DieGrid, xy_um: Floats) -> Floats:
    """Return places along the lattice, from the corner of die 0,0."""
    c, s = math.cos(grid.angle_rad), math.sin(grid.angle_rad)
    x, y = (xy_um - (grid.x0_um, grid.y0_um)).T
    return np.column_stack((c * x + s * y, c * y - s * x))


# -------------------------------------------------------------------------------------------------------------- rings


@dataclass(frozen=True, slots=True)
class _Ring:
    """Rings [first, end) of the same area with an excess of defects, and the probability of one as significant.

    resultant: mean resultant length of the directions from the centre to its defects.
    """

    first: int
    end: int
    by_chance: float
    resultant: float

    @property
    def share(self) -> float:
        """Share of the area."""
        return (self.end - self.first) / BINS


@dataclass(frozen=True, slots=True, eq=False)
class _Rings:
    """Inner radii of rings of the same inspected area; the first is 0."""

    radii_um: Floats

    @classmethod
    def of(cls, domain: _Domain, rng: np.random.Generator) -> _Rings:
        radii = np.sort(domain.radii(domain.random(DOMAIN_POINTS, rng)))
        inner = radii[np.arange(BINS) * DOMAIN_POINTS // BINS]
        inner[0] = 0.0
        return cls(inner)

    def number(self, radii_um: Floats) -> Ints:
        """Return the number of the ring of each radius."""
        return np.searchsorted(self.radii_um, radii_um, side="right") - 1

    def counts(self, xy_um: Floats, labels: Ints, domain: _Domain) -> Ints:
        """Return the number of independent defects in each ring on each wafer: of linked ones, the first.

        xy_um: [wafer, defect, (x, y)]; labels: number of the group of each defect, no group on two wafers.
        """
        n_wafers, n = xy_um.shape[:2]
        _, first = np.unique(labels, return_index=True)
        number = self.number(domain.radii(xy_um.reshape(-1, 2)[first]))
        return np.bincount(first // n * BINS + number, minlength=n_wafers * BINS).reshape(n_wafers, BINS)

    def test(self, xy_um: Floats, domain: _Domain, null: _RandomWafers) -> _Ring:
        """Return the most significant ring with the probability of one as significant on a random wafer."""
        distances = _distances(domain, len(xy_um))[TIGHT : TIGHT + 1]
        labels = _linked(xy_um, distances)[0]
        most, _ = _scanned(null.counts)
        own, ((first, end),) = _scanned(self.counts(xy_um[None], labels, domain))
        number = self.number(domain.radii(xy_um))
        away = (xy_um - domain.center_um)[(number >= first) & (number < end)]
        resultant = float(np.hypot(*(away / np.hypot(*away.T)[:, None]).mean(axis=0))) if len(away) else 0.0
        return _Ring(first, end, float(1 + np.count_nonzero(most >= own[0])) / (len(most) + 1), resultant)


def _scanned(counts: Ints) -> tuple[Floats, list[tuple[int, int]]]:
    """Return the largest log likelihood ratio of an excess for each row of counts, and its rings."""
    sums = np.concatenate((np.zeros((len(counts), 1), np.int64), counts.cumsum(axis=1)), axis=1)
    total = sums[:, -1:].astype(float)
    most, rings = np.full(len(counts), -1.0), [(0, 1)] * len(counts)
    for width in range(1, WIDEST + 1):
        inside = (sums[:, width:] - sums[:, :-width]).astype(float)
        share = width / BINS
        with np.errstate(divide="ignore", invalid="ignore"):
            within = np.where(inside > 0, inside * np.log(inside / (total * share)), 0.0)
            outside = np.where(inside < total, (total - inside) * np.log((total - inside) / (total * (1 - share))), 0.0)
        ratio = np.where(inside > total * share, within + outside, 0.0)
        best = ratio.argmax(axis=1)
        value = ratio[np.arange(len(ratio)), best]
        for k in np.flatnonzero(value > most).tolist():
            rings[k] = (int(best[k]), int(best[k]) + width)
        most = np.maximum(most, value)
    return most, rings


# ----------------------------------------------------------------------------------------------------------- clusters


@dataclass(frozen=True, slots=True, eq=False)
class _Cluster:
    """Indices of linked defects, and the probability of as many anywhere."""

    members: Ints
    by_chance: float


def _distances(domain: _Domain, n: int) -> list[float]:
    """Return the linking distances, the longest first."""
    return [math.sqrt(neighbours * domain.area_um2 / (math.pi * n)) for neighbours in NEIGHBOURS]


def _linked(xy_um: Floats, distances_um: Sequence[float]) -> list[Ints]:
    """Return, for each distance, the number of the group of each defect; the longest distance comes first."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import KDTree

    n = len(xy_um)
    pairs: Ints = KDTree(xy_um).query_pairs(distances_um[0], output_type="ndarray").reshape(-1, 2)
    apart = np.hypot(*(xy_um[pairs[:, 0]] - xy_um[pairs[:, 1]]).T)
    found: list[Ints] = []
    for distance_um in distances_um:
        i, j = pairs[apart <= distance_um].T
        graph = coo_array((np.ones(len(i), np.int8), (i, j)), shape=(n, n))
        found.append(connected_components(graph, directed=False)[1])
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _Density:
    """Numbers of defects of random wafers in a ring that was found, and outside of it; without one, all outside."""

    rings: _Rings
    ring: _Ring | None
    n_inside: int
    n_outside: int

    @classmethod
    def of(cls, xy_um: Floats, domain: _Domain, rings: _Rings, ring: _Ring | None) -> _Density:
        n_inside = 0 if ring is None else int(np.count_nonzero(_in_ring(xy_um, domain, rings, ring)))
        return cls(rings, ring, n_inside, len(xy_um) - n_inside)

    def random(self, n_wafers: int, domain: _Domain, rng: np.random.Generator) -> Floats:
        """Return random places, [wafer, defect, (x, y)]."""
        if self.ring is None:
            return domain.random(n_wafers * self.n_outside, rng).reshape(n_wafers, -1, 2)
        n_drawn = max(self.n_inside / self.ring.share, self.n_outside / (1 - self.ring.share))
        parts: tuple[list[Floats], list[Floats]] = ([], [])
        wanted = (n_wafers * self.n_outside, n_wafers * self.n_inside)
        while any(sum(map(len, part)) < n for part, n in zip(parts, wanted, strict=True)):
            drawn = domain.random(n_wafers * int(n_drawn + 1), rng)
            inside = _in_ring(drawn, domain, self.rings, self.ring)
            parts[0].append(drawn[~inside])
            parts[1].append(drawn[inside])
        each = (np.concatenate(part)[:n].reshape(n_wafers, -1, 2) for part, n in zip(parts, wanted, strict=True))
        return np.concatenate(tuple(each), axis=1)


AT_ONCE = 20_000
"""Defects of random wafers that are linked together, for speed."""


@dataclass(frozen=True, slots=True, eq=False)
class _RandomWafers:
    """Random wafers: size of the largest group at each distance [wafer, distance], independent defects in each ring."""

    largest: Ints
    counts: Ints

    @classmethod
    def of(cls, domain: _Domain, density: _Density, rng: np.random.Generator) -> _RandomWafers:
        n = density.n_inside + density.n_outside
        n_wafers, distances = FEW_SIMULATIONS if n > MANY else SIMULATIONS, _distances(domain, n)
        largest: list[Ints] = []
        counts: list[Ints] = []
        for first in range(0, n_wafers, at_once := max(1, AT_ONCE // n)):
            xy_um = density.random(min(at_once, n_wafers - first), domain, rng)
            apart = xy_um.copy()
            apart[:, :, 0] += np.arange(len(apart))[:, None] * 2 * (np.ptp(xy_um[:, :, 0]) + distances[0])
            linked = _linked(apart.reshape(-1, 2), distances)
            sizes = [np.bincount(labels)[labels].reshape(-1, n).max(axis=1) for labels in linked]
            largest.append(np.column_stack(sizes))
            counts.append(density.rings.counts(xy_um, linked[TIGHT], domain))
        return cls(np.concatenate(largest), np.concatenate(counts))


def _clusters(xy_um: Floats, domain: _Domain, null: Ints) -> list[_Cluster]:
    """Return disjoint groups, the least likely first, and among these the largest."""
    found: list[_Cluster] = []
    smallest = _smallest(null)
    for k, labels in enumerate(_linked(xy_um, _distances(domain, len(xy_um)))):
        sizes = np.bincount(labels)
        for label in np.flatnonzero(sizes > 2):
            at_distance = (1 + np.count_nonzero(null[:, k] >= sizes[label])) / (len(null) + 1)
            by_chance = (1 + np.count_nonzero(smallest <= at_distance)) / (len(null) + 1)
            found.append(_Cluster(np.flatnonzero(labels == label), float(by_chance)))
    taken: set[int] = set()
    disjoint: list[_Cluster] = []
    for cluster in sorted(found, key=lambda one: (one.by_chance, -len(one.members))):
        if taken.isdisjoint(cluster.members.tolist()):
            taken.update(cluster.members.tolist())
            disjoint.append(cluster)
    return disjoint


def _smallest(null: Ints) -> Floats:
    """Return the smallest probability over the distances for each random wafer, among the others."""
    ranks = [len(null) - np.searchsorted(np.sort(sizes), sizes, side="left") for sizes in null.T]
    return np.min(ranks, axis=0) / len(null)


# -------------------------------------------------------------------------------------------------------- signatures


def _of_cluster(cluster: _Cluster, xy_um: Floats, numbers: Ints, domain: _Domain, rings: _Rings) -> DefectSignature:
    members = xy_um[cluster.members]
    kind = _kind(members, domain, rings)
    center, axes = members.mean(axis=0), np.linalg.svd(members - members.mean(axis=0), full_matrices=False)[2]
    along, across = ((members - center) @ axis for axis in axes)
    angle_deg = math.degrees(math.atan2(axes[0, 1], axes[0, 0]) + domain.grid.angle_rad) % 180
    return DefectSignature(
        kind=kind,
        numbers=_sorted(numbers[cluster.members]),
        center=domain.to_stage(center),
        length_um=float(np.ptp(along)),
        width_um=float(np.ptp(across)),
        angle_deg=angle_deg,
        by_chance=cluster.by_chance,
    )


def _sorted(numbers: Ints) -> tuple[int, ...]:
    return tuple(sorted(numbers.tolist()))


def _kind(xy_um: Floats, domain: _Domain, rings: _Rings) -> SignatureKind:
    """Return the kind of a group by its shape."""
    radii = domain.radii(xy_um)
    angles = np.sort(np.arctan2(*(xy_um - domain.center_um).T[::-1]))
    gap = float(np.diff(np.append(angles, angles[0] + 2 * math.pi)).max())
    if 2 * math.pi - gap >= ARC_SPAN_RAD and float(radii.std()) <= ARC_SPREAD * float(radii.mean()):
        return "edge" if rings.number(radii).mean() >= EDGE_FROM * BINS else "ring"
    small, large = np.linalg.eigvalsh(np.cov(xy_um.T))
    roundness = 2 * math.sqrt(max(float(small * large), 0.0)) / float(small + large)
    is_line = float(small) * LINE_RATIO**2 <= float(large) and roundness ** (len(xy_um) - 2) <= LINE_CHANCE
    return "scratch" if is_line else "cluster"


def _of_ring(ring: _Ring, xy_um: Floats, numbers: Ints, domain: _Domain, rings: _Rings) -> DefectSignature:
    inside = _in_ring(xy_um, domain, rings, ring)
    kind: SignatureKind = "edge" if ring.end == BINS else "center" if ring.first == 0 else "ring"
    outer_um = float(rings.radii_um[ring.end]) if ring.end < BINS else float(domain.radii(xy_um).max())
    return DefectSignature(
        kind=kind,
        numbers=_sorted(numbers[inside]),
        center=domain.to_stage(domain.center_um),
        length_um=2 * outer_um,
        width_um=outer_um - float(rings.radii_um[ring.first]),
        expected=ring.share * len(xy_um),
        by_chance=ring.by_chance,
    )


def _in_ring(xy_um: Floats, domain: _Domain, rings: _Rings, ring: _Ring) -> Flags:
    number = rings.number(domain.radii(xy_um))
    return (number >= ring.first) & (number < ring.end)


def is_searchable(wafer: WaferDefects) -> bool:
    """Return whether signatures can be searched for: completely inspected dies, and not too many defects."""
    return wafer.grid is not None and bool(wafer.inspected_dies) and len(wafer.defects) <= MOST
