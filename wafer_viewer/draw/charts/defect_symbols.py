"""How the classes of defects are told apart, on the page and in reports: name, colour, shape, and the page's key."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.model.inspection.defect import DefectClass


@dataclass(frozen=True, slots=True)
class ClassSymbol:
    """A class of defects: its name, colour and shape, and the key that puts a defect into it."""

    title: str
    colour: str
    shape: str
    key: str


KINDS: dict[DefectClass, ClassSymbol] = {
    "particle": ClassSymbol("Particle", "#E66F00", "disc", "1"),
    "scratch": ClassSymbol("Scratch", "#507A9D", "bar", "2"),
    "residue": ClassSymbol("Residue", "#A0497B", "square", "3"),
    "missing die": ClassSymbol("Missing die", "#7985D9", "ring", "4"),
    "pattern": ClassSymbol("Pattern", "#279A80", "triangle", "5"),
    "pit": ClassSymbol("Pit", "#826405", "diamond", "6"),
    "edge chip": ClassSymbol("Edge chip", "#5A5BC8", "corner", "7"),
    "tilted die": ClassSymbol("Tilted die", "#855D59", "slant", "8"),
    "unmeasured": ClassSymbol("Unmeasured", "#8E9860", "cross", "9"),
}
"""No two are nearer than 10 (CIEDE2000), to red-blind and green-blind eyes either, and all stand out 3 : 1 from a light
and from a dark page; which class it is is told by the shape as well.
"""
