"""Uncertainty budget of a gauge-block check: its lines, their roles, and what it omits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean, stdev

from wafer_viewer.measure.base.uncertainty_budget import ABBE, LINEARITY, REPEATABILITY, TEMPERATURE, Z_SCALE
from wafer_viewer.model.gauge.gauge_check import Certificate, GaugeLine, GaugeRepeat, GaugeTerms, Role
from wafer_viewer.model.quantity import Contribution, Length

OF_THE_SCALE = (Z_SCALE, LINEARITY, ABBE)
"""Lines of a step's budget that are errors of the instrument's scale."""
COVERED = 0.97725
"""Cumulative probability at the upper end of a two-sided interval with k = 2."""
ODD = 0.99
"""Confidence level of the variance-ratio test; a scatter that fails it is not pooled with earlier ones."""


@dataclass(frozen=True, slots=True)
class KnownTerms:
    """Standard deviation of single scans from earlier checks, and its degrees of freedom."""

    s_um: float
    freedom: int


def budget_of(
    repeats: Sequence[GaugeRepeat], certificate: Certificate, terms: GaugeTerms, known: KnownTerms | None
) -> tuple[GaugeLine, ...]:
    """Return the budget lines, standard uncertainties (k = 1); empty where a repeat has no uncertainty."""
    if any(not repeat.height.budget for repeat in repeats):
        return ()
    lines = [*_of_scans(repeats), *_of_repeats(repeats, known), *_of_reference(certificate, terms)]
    return tuple(GaugeLine(name=name, u_um=u_um, of=role) for name, u_um, role in lines)


def length_of(value_um: float, lines: Sequence[GaugeLine], *roles: Role) -> Length:
    """Return a length with the lines of some roles as its budget; without U where there are none."""
    budget = tuple(Contribution(name=line.name, u_um=line.u_um) for line in lines if line.of in roles)
    return Length.evaluated(value_um, budget) if budget else Length(value_um=value_um)


def reference_at(certificate: Certificate, terms: GaugeTerms) -> float:
    """Return the certified step, um, at the temperature of the blocks, or as certified if that is unknown."""
    return certificate.step.value_um * (1 + certificate.expansion_per_k * _warmer_k(certificate, terms))


def not_evaluated(
    repeats: Sequence[GaugeRepeat], certificate: Certificate, terms: GaugeTerms, lines: Sequence[GaugeLine]
) -> tuple[str, ...]:
    """Return the contributions missing from the budget, a phrase each."""
    of_steps = dict.fromkeys(name for repeat in repeats for name in repeat.not_evaluated)
    missing = {
        **{name: name not in (REPEATABILITY, TEMPERATURE) for name in of_steps},
        "repeatability: it takes two scans": all(line.name != REPEATABILITY for line in lines),
        "variation in length near the joint: the certificate names no grade": certificate.variation is None,
        "temperature of the blocks: it was not given": terms.temperature_c is None,
        "expansion of the z axis": True,
        "wringing of the blocks": True,
    }
    return tuple(what for what, lacks in missing.items() if lacks)


def student(freedom: int) -> float:
    """Two-sided 95.45 % point of Student's t, which is 2 for many degrees of freedom."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, COVERED))


def _of_scans(repeats: Sequence[GaugeRepeat]) -> list[tuple[str, float, Role]]:
    """Return the root mean square over the repeats of each line of a single scan.

    They are not divided by the number of scans: form of the faces, poses and interpolation may have the same error in
    each.
    """
    names = dict.fromkeys(line.name for repeat in repeats for line in repeat.height.budget)
    return [(name, _rms(repeats, name), "scale" if name in OF_THE_SCALE else "measurement") for name in names]


def _rms(repeats: Sequence[GaugeRepeat], name: str) -> float:
    squares = [sum(line.u_um**2 for line in repeat.height.budget if line.name == name) for repeat in repeats]
    return math.sqrt(fmean(squares))


def _of_repeats(repeats: Sequence[GaugeRepeat], known: KnownTerms | None) -> list[tuple[str, float, Role]]:
    """Return s / sqrt(n), widened by Student's t so that k = 2 still covers 95 % with few scans."""
    n = len(repeats)
    own = KnownTerms(stdev(repeat.height.value_um for repeat in repeats), n - 1) if n > 1 else None
    pooled = _pooled(own, known)
    if pooled is None:
        return []
    return [(REPEATABILITY, student(pooled.freedom) / 2 * pooled.s_um / math.sqrt(n), "measurement")]


def _pooled(own: KnownTerms | None, known: KnownTerms | None) -> KnownTerms | None:
    if own is None or known is None:
        return own or known
    from scipy.special import fdtri

    if own.s_um**2 > fdtri(own.freedom, known.freedom, ODD) * known.s_um**2:
        return own
    freedom = own.freedom + known.freedom
    return KnownTerms(math.sqrt((own.freedom * own.s_um**2 + known.freedom * known.s_um**2) / freedom), freedom)


def _of_reference(certificate: Certificate, terms: GaugeTerms) -> list[tuple[str, float, Role]]:
    lines: list[tuple[str, float, Role]] = [("certificate", (certificate.step.expanded_um or 0.0) / 2, "reference")]
    if (variation_um := certificate.variation) is not None:
        lines.append(("variation in length of both blocks", _u_of_variation(variation_um), "reference"))
    if terms.temperature_c is not None:
        lines.append(("temperature of the blocks", _u_of_temperature(certificate, terms), "reference"))
    return lines


def _u_of_variation(variation_um: float) -> float:
    """Return the standard uncertainty of the difference of two blocks, certified at the centre, measured at the edge.

    A length varies by v over the face, and the centre's value within v is unknown. Its difference from the edge has a
    triangular distribution over +-v, with v / sqrt(6).
    """
    return math.sqrt(2) * variation_um / math.sqrt(6)


def _u_of_temperature(certificate: Certificate, terms: GaugeTerms) -> float:
    by_temperature = certificate.expansion_per_k * terms.u_temperature_c
    by_expansion = certificate.u_expansion_per_k * _warmer_k(certificate, terms)
    return certificate.step.value_um * math.hypot(by_temperature, by_expansion)


def _warmer_k(certificate: Certificate, terms: GaugeTerms) -> float:
    return 0.0 if terms.temperature_c is None else terms.temperature_c - certificate.temperature_c
