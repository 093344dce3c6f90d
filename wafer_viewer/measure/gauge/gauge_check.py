"""Checks against certified gauge blocks: repeats, the error of their mean with its U, En, and the verdict.

U of x holds the z scale and what scans are unsure of, and nothing of the certificate; U of the reference holds the
certificate, the variation in length and the temperature of the blocks. En = (x - ref) / sqrt(U_x^2 + U_ref^2) judges
what is claimed for x. The verdict judges the error by the guard band of ISO 14253-1; U of the error leaves the lines of
the z scale out, for errors of the scale are what is looked for (ISO 14253-5).
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Iterable, Sequence
from statistics import fmean, stdev

from wafer_viewer.measure.gauge.gauge_budget import KnownTerms, budget_of, length_of, not_evaluated, reference_at
from wafer_viewer.measure.tools.step_height import step_height
from wafer_viewer.model.acquisition.calibration import Calibration
from wafer_viewer.model.decision_rule import Word
from wafer_viewer.model.errors import MeasureError
from wafer_viewer.model.gauge.gauge_check import Certificate, GaugeCheck, GaugeRepeat, GaugeTerms
from wafer_viewer.model.quantity import Length
from wafer_viewer.model.region import Region
from wafer_viewer.model.spec import encode
from wafer_viewer.model.surface.height_map import Mosaic

FAR_FRACTION, FAR_UM = 0.02, 1.0
"""From the nominal step by more than both: other blocks."""


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
    """The step between two faces in one scan of the blocks. Raises MeasureError where `step_height` does."""
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
    """What frames a surface was made of; where that is not known, what is known of it."""
    about = surface.provenance
    return (about.input_checksum or hashlib.sha256(encode(about, "json").encode()).hexdigest())[:16]


def gauge_check(
    repeats: Sequence[GaugeRepeat],
    certificate: Certificate,
    terms: GaugeTerms = GaugeTerms(),
    *,
    known: KnownTerms | None = None,
) -> GaugeCheck:
    """What repeats say of the instrument; known: the deviation of single scans in earlier checks, pooled with theirs.

    Raises MeasureError without a repeat, where one is no repeat of the others, or where the blocks are not those of
    the certificate. Whether there can be a check at all is `refusal`'s to say.
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
    verdict, why = judged(deviation, terms.limit_um)
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


def en(x: Length, reference: Length) -> float | None:
    """(x - ref) / sqrt(U_x^2 + U_ref^2), ISO 13528; None where a U is missing or both are 0."""
    if x.expanded_um is None or reference.expanded_um is None:
        return None
    expanded_um = math.hypot(x.expanded_um, reference.expanded_um)
    return (x.value_um - reference.value_um) / expanded_um if expanded_um else None


def judged(deviation: Length, limit_um: float | None) -> tuple[Word, str]:
    """The word on an error against the largest allowed, and the sentence that says why.

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
    """Why a scan cannot be checked against a certificate, one sentence, or None.

    problem: why its lengths are uncalibrated, or None; day: of the measurement, ISO 8601.
    """
    if problem is not None or calibration is None:
        return f"There is no check without a calibration: {problem or 'the scan has none'}."
    if day > certificate.expires.isoformat():
        return (
            f"Certificate {certificate.number} expired on {certificate.expires.isoformat()} and the scan is of {day}: "
            "have the blocks certified again."
        )
    if same := set_the_scale(certificate.serials, calibration):
        return (
            f"Block {same[0]} set the z scale on {calibration.made}, so a comparison with it checks nothing: "
            "take other blocks."
        )
    return None


def set_the_scale(serials: Iterable[str], calibration: Calibration) -> tuple[str, ...]:
    """Those of some blocks that a calibration was made against, by their serial numbers."""
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
