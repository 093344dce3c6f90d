"""Verdict on a wafer from its defects and their limits, with reasons."""

from __future__ import annotations

from typing import ClassVar

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.inspection.defect import Defect, DefectLimits, Inspection
from wafer_viewer.model.inspection.die_grid import LEAST_KNOWN, DieStatus
from wafer_viewer.model.quantity import Word
from wafer_viewer.model.spec import NonNegative, Spec

LEAST_GAP = 0.02
"""Fraction of a surface; unscanned area at a ragged border of the fields is smaller."""


class DefectVerdict(Spec, frozen=True, kw_only=True):
    """Verdict on an inspected wafer, with the reasons for any word but pass.

    word: fail where a limit is exceeded, no verdict where anything that the limits cover was not inspected, else pass;
    within: True for pass alone; counted: defects without those judged a nuisance; failing: dies with more defects than
    permitted; not_inspected: dies that are not or not fully scanned, which are never clean.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    word: Word
    within: bool
    counted: int
    per_mm2: NonNegative | None
    failing: tuple[str, ...] = ()
    not_inspected: tuple[str, ...] = ()
    why: tuple[str, ...] = ()


def verdict_of(inspection: Inspection, limits: DefectLimits | None = None) -> DefectVerdict:
    """Compare the defects of an inspection with limits.

    Parameters
    ----------
    inspection : Inspection
        Result of a defect inspection.
    limits : DefectLimits, optional
        Largest number of defects on one die, and per inspected mm2. Default: the limits of the inspection's recipe.

    Returns
    -------
    DefectVerdict
        The word and whether the wafer is within the limits, with the counted defects, their number per mm2 (None if
        nothing was inspected), the failing dies, the dies that were not inspected, and the reasons.

    Notes
    -----
    Defects judged a nuisance, and unmeasured areas, are not counted. An open limit is never exceeded. A wafer on which
    nothing was inspected has no verdict, nor has one with dies that were not or only partly scanned, or one without
    known dies under a limit per die. Without dies, a surface whose unscanned area is over 2 % of its scanned area has
    no verdict. A limit that is exceeded on what was inspected fails the wafer all the same.
    """
    limits = inspection.recipe.limits if limits is None else limits
    counted = [defect for defect in inspection.found if defect.judgement != "nuisance"]
    area_mm2 = inspection.inspected_mm2
    per_mm2 = len(counted) / area_mm2 if area_mm2 else None
    failing = _failing(counted, limits)
    lacking = tuple(die.name for die in inspection.dies if _lacks_area(die, inspection))
    exceeded = (*_too_many(failing, limits), *_too_dense(per_mm2, limits))
    undecided = (*_not_inspected(lacking, per_mm2), *_gaps(inspection), *_not_countable(inspection, limits))
    word: Word = "fail" if exceeded else "no verdict" if undecided else "pass"
    return DefectVerdict(
        word=word,
        within=word == "pass",
        counted=len(counted),
        per_mm2=per_mm2,
        failing=failing,
        not_inspected=lacking,
        why=(*exceeded, *undecided),
    )


def _lacks_area(die: DieStatus, inspection: Inspection) -> bool:
    """Return whether a part of a die was not scanned; the rim of a lattice that names no dies may cut them."""
    named = inspection.grid is not None and inspection.grid.named
    beyond = named and die.state == "cut" and die.measured_fraction < LEAST_KNOWN
    return beyond or die.state in ("partly scanned", "not scanned")


def _failing(counted: list[Defect], limits: DefectLimits) -> tuple[str, ...]:
    if limits.max_per_die is None:
        return ()
    on = [defect.die for defect in counted if defect.die]
    return tuple(name for name in dict.fromkeys(on) if on.count(name) > limits.max_per_die)


def _too_many(failing: tuple[str, ...], limits: DefectLimits) -> tuple[str, ...]:
    if not failing:
        return ()
    dies = "1 die" if len(failing) == 1 else f"{len(failing)} dies"
    most = "1 defect" if limits.max_per_die == 1 else f"{limits.max_per_die} defects"
    return (f"More than {most} on {dies}: {_listed(failing)}.",)


def _too_dense(per_mm2: float | None, limits: DefectLimits) -> tuple[str, ...]:
    if limits.max_per_mm2 is None or per_mm2 is None or per_mm2 <= limits.max_per_mm2:
        return ()
    return (f"{per_mm2:.3g} defects per mm2, and {limits.max_per_mm2:g} are allowed.",)


def _not_inspected(lacking: tuple[str, ...], per_mm2: float | None) -> tuple[str, ...]:
    if per_mm2 is None:
        return ("Nothing was inspected.",)
    return (f"Not or only partly scanned, so not clean: {_listed(lacking)}.",) if lacking else ()


def _not_countable(inspection: Inspection, limits: DefectLimits) -> tuple[str, ...]:
    """Return a sentence on a limit per die where no die is known."""
    if limits.max_per_die is None or inspection.dies:
        return ()
    return (
        "No die is known, so defects per die were not counted: give the pitch and a corner of the dies, or limit the "
        "defects per mm2.",
    )


def _gaps(inspection: Inspection) -> tuple[str, ...]:
    """Return a sentence on unscanned area of a surface without known dies."""
    whole_mm2 = inspection.inspected_mm2 + inspection.unmeasured_mm2
    if inspection.dies or inspection.not_scanned_mm2 <= LEAST_GAP * whole_mm2:
        return ()
    return (f"{inspection.not_scanned_mm2:.3g} mm2 of the surface were not scanned, so it is not clean.",)


def _listed(names: tuple[str, ...], most: int = 12) -> str:
    """Return the first names and the number of further ones, separated by semicolons: die names contain commas."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return "; ".join(names[:most]) + more
