"""Defect classes: one descriptor each, with its rule, its symbol and its number in KLARF files."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from wafer_viewer.model.errors import MeasureError, WaferViewerError
from wafer_viewer.model.spec import Fraction, NonNegative, Positive, Spec, Within


@dataclass(frozen=True, slots=True, kw_only=True)
class DefectShape:
    """Features of one defect candidate, as used by the class rules.

    height_um: signed, the largest difference from the reference, negative for pits; mean_height_um: mean over its area,
    0 if unknown. score: peak over the local noise. major_um, minor_um: axis lengths of its outline. roughness_ratio:
    roughness of the residual inside, after removal of its slow shape, over the local noise; near 1 is smooth.
    steepness: median slope across its outline over |height_um| / (minor_um / 2); 1 for a cone, large for a wall, 0 if
    unknown. on_edge_fraction: fraction of its border on the edge of a die. die_fraction: fraction of the die that it
    covers. die_presence: 0 where no die is seen; die_tilt_mrad, die_bow_um, die_brightness: deviations of the die from
    the others, the last one relative, 0 where not significant. unmeasured_fraction: fraction of its area without a
    height. height_score, picture_score: signal-to-noise in heights and in the picture; detail_score: in the fine detail
    of the picture; 0 if unknown. picture_ratio: aspect ratio of the outline in the picture, 0 if nothing shows there.
    """

    height_um: float
    mean_height_um: float = 0.0
    score: float
    area_um2: float
    major_um: float
    minor_um: float
    roughness_ratio: float = 1.0
    steepness: float = 0.0
    on_edge_fraction: float = 0.0
    die_fraction: float = 0.0
    die_presence: float = 1.0
    die_tilt_mrad: float = 0.0
    die_bow_um: float = 0.0
    die_brightness: float = 0.0
    unmeasured_fraction: float = 0.0
    evidence: Literal["height", "picture", "both"] = "height"
    height_score: float = 0.0
    picture_score: float = 0.0
    detail_score: float = 0.0
    picture_ratio: float = 0.0
    pixel_um: float = 1.0

    @property
    def ratio(self) -> float:
        """Length over width, 1 for a round shape, from the evidence with the higher score.

        The focus window blurs heights. Lengths under one pixel count as one pixel.
        """
        if self.picture_ratio and self.picture_score >= self.height_score:
            return self.picture_ratio
        return max(self.major_um, self.pixel_um) / max(self.minor_um, self.pixel_um)

    @property
    def aspect(self) -> float:
        """Height over width."""
        return abs(self.height_um) / max(self.minor_um, self.pixel_um)


class ClassRules(Spec, frozen=True, kw_only=True):
    """Limits between the classes of defects; a recipe may change any of them.

    unmeasured_fraction: above it there is nothing to classify. die_fraction: a candidate that covers more of its die is
    a property of the die: missing if none is seen, else tilted above tilt_mrad, bowed above bow_um, discoloured above
    brightness_fraction, or missing if lower by more than missing_height_um. edge_fraction:
    an edge chip has more of its border on the edge of a die, and material missing. scratch_ratio: a scratch is longer
    than this multiple of its width, and longer than scratch_length_um (0 allows any length). residue_*: residue is
    wider than residue_width_um, lower than residue_aspect of its width, no rougher than residue_roughness, no steeper
    at its outline than residue_steepness, and its score in the fine detail of the picture is at most residue_picture
    times that in the heights: it has no sharp outline. pattern_height_score: a candidate that shows in the picture, and
    in the heights with a lower score than this, has no reliable height.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    unmeasured_fraction: Fraction = 0.5
    die_fraction: Fraction = 0.5
    missing_height_um: Positive = 1.0
    tilt_mrad: NonNegative = 2.0
    bow_um: NonNegative = 0.3
    brightness_fraction: NonNegative = 0.08
    edge_fraction: Fraction = 0.03
    scratch_ratio: Annotated[float, Within(1)] = 2.5
    scratch_length_um: NonNegative = 0.0
    residue_width_um: NonNegative = 4.0
    residue_aspect: Positive = 0.25
    residue_roughness: Positive = 2.5
    residue_steepness: Positive = 2.0
    residue_picture: Positive = 0.85
    pattern_height_score: Positive = 2.0


@dataclass(frozen=True, slots=True)
class Condition:
    """A number compared with its limit; `text` is the reason reported when it holds."""

    text: str
    value: float
    limit: float
    over: bool = True

    @property
    def holds(self) -> bool:
        """True if the number is on the required side of its limit."""
        return self.value > self.limit if self.over else self.value <= self.limit

    @property
    def margin(self) -> float:
        """Distance from the limit as the absolute log ratio, 0 at the limit; infinite where one of them is 0."""
        if self.value <= 0 or self.limit <= 0:
            return math.inf if self.value != self.limit else 0.0
        return abs(math.log(self.value / self.limit))


PRESENT = 0.5
"""Likeness of a place to the typical die from which it holds a die."""
Rule = Callable[[DefectShape, ClassRules], tuple[Condition, ...]]


def _unmeasured(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    share = shape.unmeasured_fraction
    return (Condition(f"{share:.0%} of it unmeasured", share, rules.unmeasured_fraction),)


def _missing_die(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    if shape.die_presence < PRESENT:
        return _of_die(shape, rules), Condition("no die is seen there", shape.die_presence, PRESENT, over=False)
    of_bow = bool(shape.die_bow_um)  # its height is that of the bow
    down_um = max(-(shape.mean_height_um if of_bow else shape.mean_height_um or shape.height_um), 0.0)
    level = Condition("it is not tilted", shape.die_tilt_mrad, rules.tilt_mrad, over=False)
    low = Condition(f"the die lies {down_um:.3g} um under the others", down_um, rules.missing_height_um)
    return _of_die(shape, rules), low, level


def _tilted_die(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    tilt = shape.die_tilt_mrad
    return _of_die(shape, rules), Condition(f"the die is tilted by {tilt:.3g} mrad", tilt, rules.tilt_mrad)


def _bowed_die(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    bow_um = abs(shape.die_bow_um)
    return _of_die(shape, rules), Condition(f"the die is bowed by {shape.die_bow_um:.3g} um", bow_um, rules.bow_um)


def _discoloured_die(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    off = shape.die_brightness
    shine = f"the die is {abs(off):.0%} {'brighter' if off > 0 else 'darker'} than the others"
    return _of_die(shape, rules), Condition(shine, abs(off), rules.brightness_fraction)


def _of_die(shape: DefectShape, rules: ClassRules) -> Condition:
    return Condition(f"covers {shape.die_fraction:.0%} of its die", shape.die_fraction, rules.die_fraction)


def _pattern(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    in_heights = f"{shape.height_score:.2g} times the noise of the heights"
    return (
        Condition("shows in the picture only", float(shape.evidence == "picture"), 0.5),
        Condition(in_heights, shape.height_score, rules.pattern_height_score, over=False),
    )


def _edge_chip(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    share = shape.on_edge_fraction
    return _gone(shape), Condition(f"{share:.0%} of its border on the edge of a die", share, rules.edge_fraction)


def _scratch(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    return (
        Condition(f"{shape.ratio:.1f} times as long as wide", shape.ratio, rules.scratch_ratio),
        Condition(f"{shape.major_um:.3g} um long", shape.major_um, rules.scratch_length_um),
    )


def _pit(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    return (_lacks(shape),)


def _residue(shape: DefectShape, rules: ClassRules) -> tuple[Condition, ...]:
    width_um, aspect = shape.minor_um, shape.aspect
    smooth = f"smooth: {shape.roughness_ratio:.2g} times the noise"
    sharp = shape.detail_score / shape.height_score if shape.height_score else 0.0
    gentle = f"no steep rim: {shape.steepness:.2g} times its mean slope" if shape.steepness else "no rim known"
    return (
        Condition(f"{shape.height_um:.3g} um high", shape.height_um, 0.0),
        Condition(f"{width_um:.3g} um wide", width_um, rules.residue_width_um),
        Condition(f"low: {aspect:.2g} of its width high", aspect, rules.residue_aspect, over=False),
        Condition(smooth, shape.roughness_ratio, rules.residue_roughness, over=False),
        Condition(gentle, shape.steepness, rules.residue_steepness, over=False),
        Condition(f"not sharp in the picture: {sharp:.2g} times the heights", sharp, rules.residue_picture, over=False),
    )


def _lacks(shape: DefectShape) -> Condition:
    return Condition(f"{-shape.height_um:.3g} um deep", -shape.height_um, 0.0)


def _gone(shape: DefectShape) -> Condition:
    """Return the condition for missing material: lower, or without heights, as at a missing wall."""
    return _lacks(shape) if shape.height_um else Condition("no height was measured here", 1.0, 0.0)


@dataclass(frozen=True, slots=True)
class DefectClassEntry:
    """A defect class: title, colour and shape of its symbol, and the key that assigns it, empty for none.

    klarf_number: CLASSNUMBER in KLARF files; 0 is not exported: unmeasured areas are not defects. code: that of a fab.
    rule: conditions that a candidate of this class meets; None: assigned by people alone, but for the particle, which
    is the class of candidates that meet no rule.
    """

    name: str
    title: str
    colour: str
    shape: str
    key: str
    klarf_number: int
    rule: Rule | None
    code: str = ""


_BY_RULE = (
    DefectClassEntry("unmeasured", "Unmeasured", "#A39165", "cross", "9", 0, _unmeasured),
    DefectClassEntry("missing die", "Missing die", "#9D6EFA", "ring", "4", 5, _missing_die),
    DefectClassEntry("tilted die", "Tilted die", "#C3677E", "slant", "8", 6, _tilted_die),
    DefectClassEntry("bowed die", "Bowed die", "#6D98B9", "arc", "", 9, _bowed_die),
    DefectClassEntry("discoloured die", "Discoloured die", "#DE1E32", "half", "", 10, _discoloured_die),
    DefectClassEntry("edge chip", "Edge chip", "#9334D9", "corner", "7", 7, _edge_chip),
    DefectClassEntry("missing bump", "Missing bump", "#2E765E", "frame", "", 11, None),
    DefectClassEntry("bridge", "Bridge", "#CB1C5A", "link", "", 12, None),
    DefectClassEntry("residue", "Residue", "#A0497B", "square", "3", 4, _residue),
    DefectClassEntry("scratch", "Scratch", "#507A9D", "bar", "2", 3, _scratch),
    DefectClassEntry("pattern", "Pattern", "#38A092", "triangle", "5", 8, _pattern),
    DefectClassEntry("pit", "Pit", "#31781A", "diamond", "6", 2, _pit),
    DefectClassEntry("particle", "Particle", "#CA8515", "disc", "1", 1, None),
)
"""All classes, in the order in which their rules are evaluated.

All pairs of colours differ by at least 10 (CIEDE2000), also with protanopia and deuteranopia, and all have a contrast
of at least 3 : 1 to light and dark pages; the shape identifies the class as well.
"""

if TYPE_CHECKING:
    DefectClass = str
else:
    DefectClass = Literal[tuple(entry.name for entry in _BY_RULE)]


class ClassTable(dict[str, DefectClassEntry]):
    """Classes by name, in the order of their keys; a name that is not among them has a neutral look."""

    def __missing__(self, name: str) -> DefectClassEntry:
        return DefectClassEntry(name, name, NEUTRAL, "disc", "", 0, None)

    @property
    def offered(self) -> tuple[DefectClassEntry, ...]:
        """Classes that people can assign; of a fab's table only its own."""
        own = tuple(entry for entry in self.values() if entry.code)
        return own or tuple(self.values())

    @property
    def numbers(self) -> dict[int, str]:
        """Titles by CLASSNUMBER, without unmeasured areas, which are not defects."""
        return {entry.klarf_number: entry.title for entry in self.offered if entry.klarf_number}


NEUTRAL = "#7A7A7A"
DEFECT_CLASSES = ClassTable({entry.name: entry for entry in sorted(_BY_RULE, key=lambda entry: entry.key or "~")})
"""The built-in table."""
RULES: dict[DefectClass, Rule] = {entry.name: entry.rule for entry in _BY_RULE if entry.rule is not None}
"""Rules in the order of evaluation; a candidate that meets none is a particle or bump."""


class FabClass(Spec, frozen=True, kw_only=True):
    """A class of a fab's own table.

    code: of the fab; colour: "#RRGGBB"; key: the digit that assigns it in the review, empty for none; klarf_number:
    CLASSNUMBER in KLARF files. kind: built-in class that the rules propose and this one stands for; empty for a class
    that people alone assign.
    """

    error: ClassVar[type[WaferViewerError]] = MeasureError
    name: str
    code: str
    colour: str
    key: str
    klarf_number: Annotated[int, Within(1)]
    kind: DefectClass | Literal[""] = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.name.strip() or not self.code.strip():
            self.refuse("name", "a name and a code of at least one letter")
        if self.name in DEFECT_CLASSES and self.name != self.kind:
            self.refuse("name", f"another name, or kind {self.name!r}: it is that of a built-in class")
        if not _COLOUR.fullmatch(self.colour):
            self.refuse("colour", "a colour as #RRGGBB, such as #CA8515")
        if self.key not in CLASS_KEYS:
            self.refuse("key", "one digit from 1 to 9, or empty")


CLASS_KEYS = ("", *"123456789")
_COLOUR = re.compile("#[0-9A-Fa-f]{6}")
FabClasses = tuple[FabClass, ...]


def require_distinct(classes: FabClasses) -> None:
    """Raise MeasureError if two classes share a name, code, key, KLARF number or built-in class."""
    for field, what in _DISTINCT.items():
        values = [value for entry in classes if (value := getattr(entry, field)) != ""]
        if twice := next((value for value in values if values.count(value) > 1), None):
            both = " and ".join(entry.name for entry in classes if getattr(entry, field) == twice)
            raise MeasureError(f"The classes {both} have the same {what}, {twice}: change one of them.")


_DISTINCT = {"name": "name", "code": "code", "key": "key", "klarf_number": "KLARF number", "kind": "built-in class"}


@cache
def class_table(classes: FabClasses = ()) -> ClassTable:
    """Return the table of a fab's classes; one that stands for a built-in class is found by that name.

    Other built-in classes keep their look, without a key and a number. Without classes: the built-in table.
    """
    if not classes:
        return DEFECT_CLASSES
    own = [_entry(entry) for entry in sorted(classes, key=lambda entry: (entry.key or "~", entry.name))]
    left = [replace(look, key="", klarf_number=0) for look in DEFECT_CLASSES.values()]
    taken = {entry.name for entry in own}
    return ClassTable({entry.name: entry for entry in (*own, *(look for look in left if look.name not in taken))})


def _entry(entry: FabClass) -> DefectClassEntry:
    name, shape = entry.kind or entry.name, DEFECT_CLASSES[entry.kind].shape
    return DefectClassEntry(name, entry.name, entry.colour, shape, entry.key, entry.klarf_number, None, entry.code)
