"""Symbols of the defect classes on the page and in reports: name, colour, shape, and keyboard key."""

from __future__ import annotations

from dataclasses import dataclass

from wafer_viewer.model.inspection.defect import DefectClass


@dataclass(frozen=True, slots=True)
class ClassSymbol:
    """Defect class symbol: name, colour and shape, and the key that assigns the class."""

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
"""Symbols by defect class.

All pairs of colours differ by at least 10 (CIEDE2000), also with protanopia and deuteranopia, and all have a contrast
of at least 3 : 1 to light and dark pages; the shape identifies the class as well.
"""
