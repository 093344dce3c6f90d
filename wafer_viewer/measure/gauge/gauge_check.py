"""Checks against certified gauge blocks: repeats, the error of their mean with its budget.

U of x comprises the z scale and the uncertainty of the scans, without the certificate. U of the reference comprises the
certificate, the variation in length and the temperature of the blocks. En = (x - ref) / sqrt(U_x^2 + U_ref^2) tests the
uncertainty claimed for x. The verdict applies the guard band of ISO 14253-1 to the error. U of the error omits the
lines of the z scale, because errors of the scale are what the check tests (ISO 14253-5).
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean, stdev

from wafer_viewer.measure.base.correlated_errors import Scatter
from wafer_viewer.measure.base.measurement_context import (
    ABBE,
    LINEARITY,
    REPEATABILITY,
    TEMPERATURE,
    Z_SCALE,
    contribution,
)
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge import Certificate, GaugeCheck, GaugeLine, GaugeRepeat, GaugeTerms, Role
from wafer_viewer.model.quantity import ROUNDING, Contribution, Length, Word
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import encode
from wafer_viewer.model.surface.height_map import Mosaic

OF_THE_SCALE = (Z_SCALE, LINEARITY, ABBE)
"""Lines of a step's budget that are errors of the instrument's scale."""
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
    lines: list[tuple[str, float | Scatter, Role]] = [
        *_of_scans(repeats),
        *_of_repeats(repeats, known),
        *_of_reference(certificate, terms),
    ]
    return tuple(_gauge_line(*line) for line in lines)


def _gauge_line(name: str, u_um: float | Scatter, of: Role) -> GaugeLine:
    line = contribution(name, u_um)
    return GaugeLine(**line.source, u_um=line.u_um, of=of)


def length_of(value_um: float, lines: Sequence[GaugeLine], *roles: Role) -> Length:
    """Return a length with the lines of some roles as its budget; without U where there are none."""
    budget = tuple(Contribution(**line.source, u_um=line.u_um) for line in lines if line.of in roles)
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


def _of_scans(repeats: Sequence[GaugeRepeat]) -> list[tuple[str, float | Scatter, Role]]:
    """Return the root mean square over the repeats of each line of a single scan, with the least degrees of freedom.

    They are not divided by the number of scans: form of the faces, poses and interpolation may have the same error in
    each.
    """
    names = dict.fromkeys(line.name for repeat in repeats for line in repeat.height.budget)
    return [(name, _rms(repeats, name), "scale" if name in OF_THE_SCALE else "measurement") for name in names]


def _rms(repeats: Sequence[GaugeRepeat], name: str) -> float | Scatter:
    lines = [line for repeat in repeats for line in repeat.height.budget if line.name == name]
    u_um = math.sqrt(sum(line.u_um**2 for line in lines) / len(repeats))
    freedoms = [line.freedom for line in lines if line.freedom is not None]
    by_scatter = any(line.evaluation == "A" for line in lines)
    return Scatter(u_um, min(freedoms, default=math.inf)) if by_scatter else u_um


def _of_repeats(repeats: Sequence[GaugeRepeat], known: KnownTerms | None) -> list[tuple[str, Scatter, Role]]:
    """Return s / sqrt(n) with its degrees of freedom."""
    n = len(repeats)
    own = KnownTerms(stdev(repeat.height.value_um for repeat in repeats), n - 1) if n > 1 else None
    pooled = _pooled(own, known)
    if pooled is None:
        return []
    return [(REPEATABILITY, Scatter(pooled.s_um / math.sqrt(n), pooled.freedom), "measurement")]


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


FAR_FRACTION = 0.02
"""Deviation from the nominal step, relative to it, beyond which the blocks are other ones."""
FAR_UM = 1.0
"""Smallest such deviation, um."""


def gauge_repeat(
    surface: Mosaic,
    upper: Region,
    lower: Region,
    *,
    dataset: str,
    taken: str = "",
    show: int = 0,
    calibration_valid: bool = True,
) -> GaugeRepeat:
    """Measure the step between two faces in one scan of the gauge blocks.

    Parameters
    ----------
    surface : Mosaic
        The scan of the blocks.
    upper, lower : Region
        Region on the upper face and region on the lower face, stage um.
    dataset : str
        Name of the dataset of the scan.
    taken : str, default ""
        Time of the scan; with the name of the dataset it identifies the scan. Empty: not known.
    show : int, default 0
        0 for the stitched surface, else the number of the field that was measured.
    calibration_valid : bool, default True
        False: the height has the status "uncalibrated" and no uncertainty, as without a calibration.

    Returns
    -------
    GaugeRepeat
        The height of `upper` over `lower` in um with its expanded uncertainty (k = 2), its definition, the
        contributions that were not evaluated, the calibration and a mark of the frames of the surface.

    Raises
    ------
    MeasureError
        As `step_height`: if a region is a line or a point, lies outside the surface, has fewer than 200 measured points
        or less than half of its area measured, overlaps the other, or its points do not determine a plane. Also if the
        upper region is below the lower one.
    """
    found = step_height(surface, upper, lower, calibration_valid=calibration_valid)
    if found.height.value_um < 0:
        raise MeasureError(
            f"The upper region lies {-found.height.value_um:.1f} um below the lower one: give them the other way round."
        )
    return GaugeRepeat(
        dataset=dataset,
        taken=taken,
        surface=frames_mark(surface),
        show=show,
        upper=upper,
        lower=lower,
        height=found.height,
        definition=found.definition,
        not_evaluated=found.not_evaluated,
        calibration=surface.provenance.calibration,
        simulated=found.simulated,
    )


def frames_mark(surface: Mosaic) -> str:
    """Return a hash that identifies the frames of a surface, or its provenance where they are unknown."""
    about = surface.provenance
    return (about.input_checksum or hashlib.sha256(encode(about, "json").encode()).hexdigest())[:16]


def gauge_check(
    repeats: Sequence[GaugeRepeat],
    certificate: Certificate,
    terms: GaugeTerms = GaugeTerms(),
    *,
    known: KnownTerms | None = None,
) -> GaugeCheck:
    """Evaluate repeats of a gauge-block measurement against a certificate.

    The error is the mean of the repeats minus the certified step at the temperature of the blocks. `refusal` decides
    beforehand if a check is possible.

    Parameters
    ----------
    repeats : sequence of GaugeRepeat
        The step in one or more scans of the blocks, in order; all scans differ and have the same calibration.
    certificate : Certificate
        Certified step, or two certified blocks, with U (k = 2).
    terms : GaugeTerms, optional
        Largest permitted error in um, and temperature of the blocks in degrees Celsius. What is not given is not
        evaluated: without a limit there is no verdict.
    known : KnownTerms, optional
        Scatter of single scans in earlier checks: standard deviation in um and degrees of freedom. It is pooled with
        the scatter of the repeats, unless theirs is significantly larger (variance-ratio test at 99 %). By default the
        scatter of the repeats alone counts.

    Returns
    -------
    GaugeCheck
        Mean (`height`), `reference` and error (`deviation`) in um with their expanded uncertainties (k = 2), standard
        deviation and range of two or more repeats, En, verdict with its reason, budget lines, and the contributions
        that were not evaluated. Regions and field number are those of the last repeat. If a repeat has no uncertainty,
        neither has the check: En is None and the verdict "no verdict".

    Raises
    ------
    MeasureError
        If there is no repeat; one is no repeat of the others, because it is of the same scan or was made with another
        calibration; or the blocks are not those of the certificate: the mean is off the nominal step by more than 1 um
        and by more than 2 %.

    Notes
    -----
    U of the mean comprises the z scale and the uncertainty of the scans, without the certificate. U of the reference
    comprises the certificate, the variation in length and the temperature of the blocks. En = (x - ref) / sqrt(U_x^2 +
    U_ref^2) tests the uncertainty claimed for x. The verdict applies the guard band of ISO 14253-1 to the error: pass
    where all of error +- U lies within +- the limit, fail where none of it does. U of the error omits the lines of the
    z scale, because errors of the scale are what the check tests (ISO 14253-5).

    References
    ----------
    ISO 14253-1 (guard band), ISO 14253-5 (uncertainty in verification testing), ISO 13528 (En), ISO 3650 (gauge
    blocks).
    """
    _require_repeats(repeats)
    heights = [repeat.height.value_um for repeat in repeats]
    mean_um = fmean(heights)
    _require_right_blocks(mean_um, certificate)
    lines = budget_of(repeats, certificate, terms, known)
    reference_um = reference_at(certificate, terms)
    x = length_of(mean_um, lines, "scale", "measurement")
    reference = length_of(reference_um, lines, "reference")
    deviation = length_of(mean_um - reference_um, lines, "measurement", "reference")
    verdict, why = judge_check(deviation, terms, len(repeats))
    score = en(x, reference)
    return GaugeCheck(
        certificate=certificate,
        terms=terms,
        repeats=tuple(repeats),
        upper=repeats[-1].upper,
        lower=repeats[-1].lower,
        height=x,
        reference=reference,
        deviation=deviation,
        s_um=stdev(heights) if len(heights) > 1 else None,
        range_um=max(heights) - min(heights) if len(heights) > 1 else None,
        en=score,
        en_why=_en_why(score),
        verdict=verdict,
        why=why,
        budget=lines,
        not_evaluated=not_evaluated(repeats, certificate, terms, lines),
        show=repeats[-1].show,
        simulated=any(repeat.simulated for repeat in repeats),
    )


def contradiction(check: GaugeCheck) -> str | None:
    """Return the first thing that a stored check says against its own repeats, certificate and budget; None if none.

    Everything but the budget is derived again from them, so a number that was changed in the file contradicts another.
    """
    mean_um, reference_um = (
        fmean(r.height.value_um for r in check.repeats),
        reference_at(check.certificate, check.terms),
    )
    derived = {
        "height": length_of(mean_um, check.budget, "scale", "measurement"),
        "reference": length_of(reference_um, check.budget, "reference"),
        "error": length_of(mean_um - reference_um, check.budget, "measurement", "reference"),
    }
    stored = {"height": check.height, "reference": check.reference, "error": check.deviation}
    for name, length in derived.items():
        if not _agree(length, stored[name]):
            return f"the {name} is said to be {_text(stored[name])}, and is {_text(length)} by its repeats and budget"
    word, _ = judge_check(check.deviation, check.terms, check.n)
    if word != check.verdict:
        return f"the verdict is said to be {check.verdict}, and is {word} by the error and its limit"
    score = en(check.height, check.reference)
    if (score is None) != (check.en is None) or not math.isclose(score or 0.0, check.en or 0.0, abs_tol=ROUNDING):
        return "En is not that of the height and the reference"
    return None


def _agree(a: Length, b: Length) -> bool:
    pairs = ((a.value_um, b.value_um), (a.expanded_um or 0.0, b.expanded_um or 0.0), (a.k, b.k))
    return all(math.isclose(x, y, rel_tol=ROUNDING, abs_tol=ROUNDING) for x, y in pairs)


def _text(length: Length) -> str:
    return f"{length.value_um:.4f} um, U {length.expanded_um or 0.0:.4f} um, k {length.k:.4f}"


def en(x: Length, reference: Length) -> float | None:
    """Return the En number, (x - ref) / sqrt(U_x^2 + U_ref^2), ISO 13528; None where a U is missing or both are 0."""
    if x.expanded_um is None or reference.expanded_um is None:
        return None
    expanded_um = math.hypot(x.expanded_um, reference.expanded_um)
    return (x.value_um - reference.value_um) / expanded_um if expanded_um else None


def judge_check(deviation: Length, terms: GaugeTerms, n: int) -> tuple[Word, str]:
    """Return the verdict of a check of n scans, and the reason; a pass says where its U knows of no repeatability."""
    if n < terms.least_repeats:
        missing = terms.least_repeats - n
        scans = "1 more scan" if missing == 1 else f"{missing} more scans"
        return "no verdict", f"A verdict takes {terms.least_repeats} scans: add {scans} of the blocks."
    word, why = judge_error(deviation, terms.limit_um)
    if word == "pass" and all(line.name != REPEATABILITY for line in deviation.budget):
        return word, f"{why} Repeatability is not known: it takes two scans."
    return word, why


def judge_error(deviation: Length, limit_um: float | None) -> tuple[Word, str]:
    """Return the verdict on an error against its limit, and the reason.

    Guard band (ISO 14253-1): pass where all of error ± U lies within ± the limit, fail where none of it does.
    """
    if deviation.expanded_um is None:
        return "no verdict", "There is no uncertainty, so the error cannot be judged."
    if limit_um is None:
        return "no verdict", "No limit was given for the error."
    size, half = abs(deviation.value_um), deviation.expanded_um
    if size + half <= limit_um:
        return "pass", f"The error and its U lie within the limit of {limit_um:g} um."
    if size - half > limit_um:
        return "fail", f"The error lies beyond the limit of {limit_um:g} um by more than its U."
    if half > limit_um:
        return "inconclusive", f"U is {half:.2g} um and the limit {limit_um:g} um: these blocks cannot show it."
    return "inconclusive", f"The error is {abs(limit_um - size):.2g} um from the limit, with U = {half:.2g} um."


def refusal(certificate: Certificate, calibration: Calibration | None, problem: str | None, day: str) -> str | None:
    """Return the reason that a scan cannot be checked against a certificate, one sentence, or None.

    problem: reason that its lengths are uncalibrated, or None; day: of the measurement, ISO 8601.
    """
    if problem is not None or calibration is None:
        return f"There is no check without a calibration: {problem or 'the scan has none'}."
    if day > certificate.expires.isoformat():
        return (
            f"Certificate {certificate.number} expired on {certificate.expires.isoformat()} and the scan is of {day}: "
            "have the blocks certified again."
        )
    if same := blocks_used_for_calibration(certificate.serials, calibration):
        return (
            f"Block {same[0]} set the z scale on {calibration.made}, so a comparison with it checks nothing: "
            "take other blocks."
        )
    return None


def blocks_used_for_calibration(serials: Iterable[str], calibration: Calibration) -> tuple[str, ...]:
    """Return the serial numbers of blocks against which a calibration was made."""
    words = re.split(r"[\s,;:()]+", calibration.against)
    standards = {word.strip(".").casefold() for word in (*words, *calibration.z_against)}
    return tuple(serial for serial in serials if serial.casefold() in standards)


def require_new(repeat: GaugeRepeat, others: Iterable[GaugeRepeat]) -> None:
    """Raise MeasureError where a scan is in a check already, or was made with another calibration."""
    for other in others:
        if other.is_scan_of(repeat):
            raise MeasureError(f"{repeat.dataset} is in the check already: a repeat is a new scan of the blocks.")
        if other.calibration != repeat.calibration:
            raise MeasureError(
                f"{repeat.dataset} was calibrated otherwise than {other.dataset}: begin another check with it."
            )


def _require_repeats(repeats: Sequence[GaugeRepeat]) -> None:
    if not repeats:
        raise MeasureError("The check has no repeat yet: measure the blocks in one scan at least.")
    for n, repeat in enumerate(repeats):
        require_new(repeat, repeats[:n])


def _require_right_blocks(mean_um: float, certificate: Certificate) -> None:
    nominal_um = certificate.step_nominal_um
    if abs(mean_um - nominal_um) > max(FAR_UM, FAR_FRACTION * nominal_um):
        raise MeasureError(
            f"The step measures {mean_um:.1f} um and certificate {certificate.number} is of {nominal_um:g} um: "
            "these are other blocks, or a region lies off its face."
        )


def _en_why(score: float | None) -> str:
    if score is None:
        return ""
    if abs(score) <= 1:
        return "The U claimed for the step holds: |En| is at most 1."
    return "The U claimed for the step is too small, or the z scale is off: |En| is over 1."
