"""Glossary: one term per concept, shared by page, command line, reports and documentation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Subject = Literal["Acquisition", "Surface", "Measurement", "Gauge check", "Inspection", "Session"]


@dataclass(frozen=True, slots=True)
class Term:
    """One concept: its term, meaning and source, and the synonyms that are not used."""

    word: str
    subject: Subject
    meaning: str
    source: str = ""
    not_called: tuple[str, ...] = ()


GLOSSARY: tuple[Term, ...] = (
    # ------------------------------------------------------------------------------------------------- acquisition
    Term("field", "Acquisition", "The area that the camera sees at one stage position, and all that is taken there."),
    Term("field grid", "Acquisition", "Rows and columns of overlapping fields that cover the sample.", "paper"),
    Term("frame", "Acquisition", "One image of the camera, named by the field, z and exposure it belongs to."),
    Term(
        "focus stack", "Acquisition", "The frames of one field at rising z, from which its heights are made.", "paper"
    ),
    Term("focus sweep", "Acquisition", "The z range and step of a focus stack."),
    Term(
        "z window", "Acquisition", "The part of the focus sweep that is taken of one field, when a scan follows focus."
    ),
    Term(
        "coarse look", "Acquisition", "Sweeps of a few fields in coarse steps, from which all z windows are predicted."
    ),
    Term("exposure", "Acquisition", "The time for which a frame collects light; a sweep may have several."),
    Term("bracket", "Acquisition", "Several exposures of each z, fused to one linear picture without dark areas."),
    Term("stage", "Acquisition", "The axes X, Y and Z that move the sample, each with a scale."),
    Term("scale", "Acquisition", "The encoder of an axis: it counts while the axis moves.", "paper"),
    Term("count", "Acquisition", "The smallest step of a scale."),
    Term("index mark", "Acquisition", "A place on a scale with a signal of its own, by which its count can be set."),
    Term("pulse", "Acquisition", "A trigger for the camera, fired when a scale reaches a count.", "paper"),
    Term("pulse box", "Acquisition", "The device that counts the scales and fires the pulses."),
    Term("motion controller", "Acquisition", "The device that drives axes of the stage, in units of its own."),
    Term(
        "positioner",
        "Acquisition",
        "A motorised setting of the instrument beside X, Y and Z: light, objective, zoom, tilt or rotation.",
    ),
    Term("homing", "Acquisition", "The search of an axis for its reference, after which its position is known."),
    Term("pass", "Acquisition", "One continuous motion of an axis with the pulses that it fires."),
    Term(
        "live view",
        "Acquisition",
        "The picture of the camera before a scan, while the stage is driven to what is sought.",
    ),
    Term(
        "jog",
        "Acquisition",
        "Motion of an axis for as long as a key is held; the rig stops by itself when nothing renews it.",
        not_called=("creep",),
    ),
    Term("step", "Acquisition", "Motion by a set distance at a tap of a key; also the distance of two frames in z."),
    Term("go to focus", "Acquisition", "Search for the z at which the whole frame is sharpest, and motion there."),
    Term("focus score", "Acquisition", "Sharpness of a whole frame; the live view shows it as a share of the best."),
    Term("clearance", "Acquisition", "Least distance of the objective from the highest known point of the sample."),
    Term("safe z", "Acquisition", "The z over everything on the stage, at which long drives in X and Y are made."),
    Term("strategy", "Acquisition", "The order of passes that takes all frames of a plan; the fastest is chosen."),
    Term("plan", "Acquisition", "Fields, sweep, exposures and strategy of a scan, with its predicted time."),
    Term("scan", "Acquisition", "The taking of all frames of a plan."),
    Term("missing frame", "Acquisition", "A frame that was planned and not stored; it is taken again."),
    Term("rig", "Acquisition", "Stage, pulse box and camera together, real or simulated."),
    Term("conformance check", "Acquisition", "A demand of a scan on the devices of a rig, measured on the rig itself."),
    Term("SIMULATED", "Acquisition", "Stands on everything that the virtual rig has produced."),
    Term("dataset", "Acquisition", "The folder NAME.wafer with the frames of a scan and all that was made of them."),
    Term("alignment", "Acquisition", "Position and rotation of the wafer on the stage, from marked corners of dies."),
    Term("sample", "Acquisition", "The object on the stage, with its names."),
    Term(
        "continue",
        "Acquisition",
        "Take the frames that an unfinished scan lacks.",
        not_called=("go on with", "goes on with"),
    ),
    # ----------------------------------------------------------------------------------------------------- surface
    Term("shape from focus", "Surface", "Heights from the z at which each pixel is sharpest.", "Nayar 1994; paper"),
    Term("focus measure", "Surface", "The measure of sharpness round a pixel in one frame.", "Pertuz 2013"),
    Term("focus curve", "Surface", "The focus measure of one pixel over z; its peak is the height."),
    Term(
        "gate",
        "Surface",
        "A test of a peak: peaks that pass all vouch for others; the first failed is the reason of improbable ones.",
    ),
    Term(
        "confidence",
        "Surface",
        "Probability that a height is right by all its evidence; without gates, how far the peak stands out.",
    ),
    Term(
        "uncertainty of a height",
        "Surface",
        "Standard uncertainty of one measured height, from noise, frames and the form under the focus window.",
        "GUM",
    ),
    Term(
        "height map",
        "Surface",
        "The heights of one field, a pixel each, with confidence, uncertainty and origin.",
        "",
        ("depth map",),
    ),
    Term(
        "measured heights",
        "Surface",
        "Heights that passed every gate, before any filter. Measurements use them.",
        not_called=("raw heights", "unsmoothed heights"),
    ),
    Term(
        "filtered heights",
        "Surface",
        "Measured heights after smoothing and the removal of outliers.",
        not_called=("cleaned heights", "smoothed heights"),
    ),
    Term("filled", "Surface", "Of a pixel: its height is interpolated over a gap and was not measured there."),
    Term("unmeasured", "Surface", "Of a pixel: it has no height; the origin says why."),
    Term("origin", "Surface", "Of a pixel: measured, filled, or the reason why it is unmeasured."),
    Term("outlier", "Surface", "A height that no neighbour supports.", "paper"),
    Term(
        "all-in-focus picture",
        "Surface",
        "Each pixel as it is with the focus at its height.",
        "",
        ("picture in focus",),
    ),
    Term("recipe", "Surface", "All settings that turn focus stacks into a surface; each may be automatic."),
    Term("overlap", "Surface", "What two neighbouring fields both see; stitching compares it.", "paper"),
    Term("registration", "Surface", "The measurement of how far a field is offset from its neighbour, in the overlap."),
    Term("pose", "Surface", "Position, height and tilt of a field in the stitched surface."),
    Term("stitched surface", "Surface", "The heights of all fields in one map.", "paper", ("splicing",)),
    Term("level", "Surface", "The zero from which heights are read: the stage's, a plane or a form.", "ISO 25178-2"),
    Term("point cloud", "Surface", "The surface drawn as points, one a measured pixel."),
    Term("refused point", "Surface", "A peak that failed a gate, drawn at its own height and coloured by the reason."),
    Term("slab", "Surface", "The points between two upright planes along a line; their section is its profile."),
    Term("depth of field", "Surface", "The range of z in which a plane appears sharp, set by NA and wavelength."),
    # ------------------------------------------------------------------------------------------------- measurement
    Term(
        "region",
        "Measurement",
        "A rectangle, circle, polygon, line or polyline in stage µm on which something is measured.",
    ),
    Term("result", "Measurement", "A measurement that was kept, with number, name, place and uncertainty."),
    Term("profile", "Measurement", "Heights along a line or a polyline, averaged over a width.", "ISO 21920-2"),
    Term("Pt", "Measurement", "Total height of a profile.", "ISO 21920-2"),
    Term("step height", "Measurement", "The height of one face over another.", "ISO 5436-1"),
    Term("groove", "Measurement", "A profile with two edges, deeper or higher between them.", "ISO 5436-1"),
    Term("flatness, FLTt", "Measurement", "Peak-to-valley deviation from the reference plane.", "ISO 12781-1"),
    Term(
        "minimum zone", "Measurement", "The two parallel planes closest to each other that hold a face.", "ISO 12781-1"
    ),
    Term("texture", "Measurement", "Areal surface parameters such as Sa, Sq and Sz.", "ISO 25178-2"),
    Term("roughness", "Measurement", "Profile parameters such as Ra and Rq.", "ISO 21920-2"),
    Term("nesting index", "Measurement", "The wavelength at which a filter separates.", "ISO 16610"),
    Term("form", "Measurement", "The polynomial that is removed before texture is measured.", "ISO 25178-2"),
    Term("kerf", "Measurement", "The channel that a saw or laser cut between dies."),
    Term("chipping", "Measurement", "Material broken off along an edge of a die."),
    Term("coplanarity", "Measurement", "Largest distance of the tops of bumps from one plane.", "JEDEC JESD22-B108"),
    Term("site range", "Measurement", "Range of heights of the front surface in each site, as mounted."),
    Term(
        "uncertainty, U",
        "Measurement",
        "Expanded uncertainty, k times the standard one: it covers 95.45 %.",
        "GUM",
    ),
    Term("budget", "Measurement", "The list of contributions to an uncertainty, and of those not evaluated.", "GUM"),
    Term("uncalibrated", "Measurement", "Of a length: no valid calibration holds, so it has no U and gets no verdict."),
    # ------------------------------------------------------------------------------------------------- gauge check
    Term("gauge block", "Gauge check", "A block of certified length; two of them make a certified step.", "ISO 3650"),
    Term("certificate", "Gauge check", "Certified value, U, laboratory and expiry of the blocks."),
    Term("calibration", "Gauge check", "Pixel size and scales with their U, valid until a date."),
    Term(
        "instrument",
        "Gauge check",
        "The look of Gauge check with the calibrations: values with U, what is due, and a run of each.",
    ),
    Term("due", "Gauge check", "Of a calibration or certificate: the day until which it is valid."),
    Term("trigger delay", "Gauge check", "Time from the pulse to the start of the exposure."),
    Term("measurement noise", "Gauge check", "Root mean square noise of the heights of one scan.", "ISO 25178-600"),
    Term("flatness deviation", "Gauge check", "Range of heights that a perfect flat appears to have.", "ISO 25178-600"),
    Term("flat field", "Gauge check", "Relative sensitivity and dark level of the camera over the image.", "EMVA 1288"),
    Term("dark level", "Gauge check", "Counts of the camera without light.", "EMVA 1288"),
    Term(
        "x-y mapping deviation",
        "Gauge check",
        "Measured minus true place of a point in the image, after pixel size and rotation.",
        "ISO 25178-600",
    ),
    Term("width of the response to a step", "Gauge check", "Distance across a steep edge from level to level."),
    Term("amplification coefficient", "Gauge check", "Slope of measured over true height.", "ISO 25178-600"),
    Term("linearity deviation", "Gauge check", "Largest distance from that line.", "ISO 25178-600"),
    Term("repeat", "Gauge check", "One scan of the blocks, measured against the certificate."),
    Term("error", "Gauge check", "Measured minus certified value.", "VIM"),
    Term("En", "Gauge check", "Error over the root of the sum of both squared U.", "ISO 17043"),
    Term("run chart", "Gauge check", "The errors of the signed checks over time, with limits and drift."),
    Term("Cg, Cgk", "Gauge check", "Capability of a gauge against a tolerance."),
    Term("gauge R&R", "Gauge check", "Repeatability and reproducibility of a measurement.", "AIAG MSA"),
    # -------------------------------------------------------------------------------------------------- inspection
    Term("die", "Inspection", "One of the equal parts that a wafer is divided into."),
    Term("street", "Inspection", "The strip between dies."),
    Term("pitch", "Inspection", "The distance from die to die."),
    Term(
        "defect", "Inspection", "A place that differs from the reference by more than the noise explains.", "SEMI M50"
    ),
    Term("reference", "Inspection", "What dies are compared with: the other dies, a golden die or the fitted form."),
    Term("golden die", "Inspection", "A stored median of good dies, with its spread."),
    Term("defect class", "Inspection", "The kind of a defect, such as particle, pit, scratch or residue."),
    Term("sensitivity", "Inspection", "The threshold of the inspection, from 0 (clear defects only) to 1."),
    Term("capture rate", "Inspection", "Share of the true defects that are found.", "SEMI M50"),
    Term("false count", "Inspection", "Reported defects that are none, in a square millimetre.", "SEMI M50"),
    Term("nuisance", "Inspection", "A reported difference that a person judged to be no defect.", "SEMI M50"),
    Term("KLARF", "Inspection", "The text format in which yield systems exchange defects.", "KLARF 1.2, 1.8"),
    Term("bin", "Inspection", "What a wafer map says of a die: pass, fail, missing or not inspected.", "SEMI E142"),
    Term(
        "kill ratio",
        "Inspection",
        "Share of the dies that a class of defects makes fail, of those with it.",
        "ASMC 1999",
    ),
    Term("adder", "Inspection", "A defect that an earlier inspection of the same wafer does not have."),
    Term(
        "signature", "Inspection", "Defects that lie together as chance does not explain: cluster, scratch, ring, edge."
    ),
    Term("stack", "Inspection", "The defects of several wafers on one wafer map."),
    Term(
        "control limit", "Inspection", "Bound that the density of a wafer exceeds by chance in 0.135 %.", "ISO 7870-2"
    ),
    # ----------------------------------------------------------------------------------------------------- session
    Term("job", "Session", "A plan with features and limits that an engineer releases and an operator runs."),
    Term("feature", "Session", "A quantity of the job with its limits."),
    Term("verdict", "Session", "PASS, FAIL, INCONCLUSIVE or NO VERDICT.", "ISO 14253-1"),
    Term("guard band", "Session", "Decision rule: value ± U must lie within the limits.", "ISO 14253-1"),
    Term("judgement", "Session", "What a person decided about a defect or result: accept or reject."),
    Term(
        "controls", "Session", "The right to move the rig and to change plan, dataset or results; one browser has it."
    ),
)


def terms_of(subject: Subject) -> tuple[Term, ...]:
    """Return the terms of one subject, in the order in which they build on each other."""
    return tuple(term for term in GLOSSARY if term.subject == subject)


def find_terms(text: str) -> tuple[Term, ...]:
    """Return the terms whose word, or unused synonym, contains `text`, ignoring case."""
    wanted = text.strip().lower()
    return tuple(t for t in GLOSSARY if any(wanted in word.lower() for word in (t.word, *t.not_called)))


def glossary_markdown() -> str:
    """Return the documentation page that lists every term."""
    parts = [_HEAD]
    for subject in get_args(Subject):
        rows = (f"| {t.word} | {_meaning(t)} | {t.source} |" for t in terms_of(subject))
        parts.append("\n".join((f"## {subject}\n", "| term | meaning | source |", "|---|---|---|", *rows)))
    return "\n\n".join(parts) + "\n"


def _meaning(term: Term) -> str:
    return f"{term.meaning} Not: {', '.join(term.not_called)}." if term.not_called else term.meaning


_HEAD = """# Glossary

The words that the page, the command line, the reports and the documentation share. `wafer-viewer glossary` prints
them, *Glossary* in the command palette shows them. *paper* is the paper on shape from focus that the method comes
from."""
