"""How the classes of defects are told apart, on the page and in reports: name, colour, shape, and the page's key."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.model.defects import DefectClass


@dataclass(frozen=True, slots=True)
class KindLook:
    """A class of defects: its name, colour and shape, and the key that puts a defect into it."""

    title: str
    colour: str
    shape: str
    key: str


KINDS: dict[DefectClass, KindLook] = {
    "particle": KindLook("Particle", "#D55E00", "disc", "1"),
    "scratch": KindLook("Scratch", "#0072B2", "bar", "2"),
    "residue": KindLook("Residue", "#B5529B", "square", "3"),
    "missing die": KindLook("Missing die", "#7A8794", "ring", "4"),
    "pattern": KindLook("Pattern", "#008F6B", "triangle", "5"),
    "pit": KindLook("Pit", "#8A6D00", "diamond", "6"),
    "edge chip": KindLook("Edge chip", "#4B4FA6", "corner", "7"),
    "tilted die": KindLook("Tilted die", "#56616C", "slant", "8"),
    "unmeasured": KindLook("Unmeasured", "#7A8794", "cross", "9"),
}
"""The shape is needed: by colour alone some come close for eyes that do not tell red from green."""
