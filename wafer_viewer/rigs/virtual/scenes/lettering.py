"""Letters on a die: a font of 3 x 5 squares, drawn by a kernel."""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.numerics.jit import fast_kernel
from wafer_viewer.rigs.virtual.scenes.shapes import rectangle

ROWS = {  # five rows from the top, three bits each
    "0": (7, 5, 5, 5, 7),
    "1": (2, 6, 2, 2, 7),
    "2": (7, 1, 7, 4, 7),
    "3": (7, 1, 7, 1, 7),
    "4": (5, 5, 7, 1, 1),
    "5": (7, 4, 7, 1, 7),
    "6": (7, 4, 7, 5, 7),
    "7": (7, 1, 1, 2, 2),
    "8": (7, 5, 7, 5, 7),
    "9": (7, 5, 7, 1, 7),
    "R": (6, 5, 6, 5, 5),
    "C": (7, 4, 4, 4, 7),
    "W": (5, 5, 7, 7, 5),
    "V": (5, 5, 5, 5, 2),
    "-": (0, 0, 7, 0, 0),
    " ": (0, 0, 0, 0, 0),
}
CODES = {letter: code for code, letter in enumerate(ROWS)}
INK = np.array([[[row >> (2 - x) & 1 for x in range(3)] for row in rows] for rows in ROWS.values()], np.bool_)
PRODUCT = tuple(CODES[letter] for letter in "WV-28 ")
LETTER_R, LETTER_C, SPACE = CODES["R"], CODES["C"], CODES[" "]


@fast_kernel
def product_letter(place: int) -> int:
    """The code of a letter of the product's name; a space past its end."""
    return PRODUCT[place] if 0 <= place < len(PRODUCT) else SPACE


@fast_kernel
def place_letter(place: int, column: int, row: int) -> int:
    """The code of a letter of R07C06, the die's place on the wafer; digits are their own codes."""
    number = row if place < 3 else column
    digit = place % 3
    if place < 0 or place > 5:
        return SPACE
    if digit == 0:
        return LETTER_R if place == 0 else LETTER_C
    return number // 10 % 10 if digit == 1 else number % 10


@fast_kernel
def glyph(code: int, x: float, y: float, footprint: float) -> float:
    """Ink of one letter at x in [0, 3) and y in [0, 5), in squares, y from the top."""
    ink = 0.0
    for row in range(5):
        for column in range(3):
            if INK[code, row, column]:
                ink += rectangle(x - column, y - row, 0.0, 1.0, 0.0, 1.0, footprint)
    return ink


@fast_kernel
def two_lines(u: float, v: float, column: int, row: int, footprint: float) -> float:
    """Ink of the product's name over the die's place, in a block 92 um wide and 90 um high; (u, v) from its corner."""
    first = v > 40.0
    square_um = 3.4 if first else 3.0
    x = (u - 5.0) / square_um
    y = ((62.0 if first else 30.0) - v) / square_um
    if x < -0.3 or x > 24.0 or y < -0.3 or y > 5.3:
        return 0.0
    place = math.floor((x + 0.5) / 4.0)
    code = product_letter(place) if first else place_letter(place, column, row)
    return min(glyph(code, x - 4.0 * place, y, footprint / square_um), 1.0)
