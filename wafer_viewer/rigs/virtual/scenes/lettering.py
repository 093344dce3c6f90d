"""Lettering on a die: a font of 5 x 7 squares, drawn by a kernel."""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.numerics.jit import fast_kernel
from wafer_viewer.rigs.virtual.scenes.shapes import rectangle

ROWS = {  # seven rows from the top
    "0": ".###. #...# #..## #.#.# ##..# #...# .###.",
    "1": "..#.. .##.. ..#.. ..#.. ..#.. ..#.. .###.",
    "2": ".###. #...# ....# ..##. .#... #.... #####",
    "3": ".###. #...# ....# ..##. ....# #...# .###.",
    "4": "...#. ..##. .#.#. #..#. ##### ...#. ...#.",
    "5": "##### #.... ####. ....# ....# #...# .###.",
    "6": ".###. #.... #.... ####. #...# #...# .###.",
    "7": "##### ....# ...#. ..#.. .#... .#... .#...",
    "8": ".###. #...# #...# .###. #...# #...# .###.",
    "9": ".###. #...# #...# .#### ....# ....# .###.",
    "R": "####. #...# #...# ####. #.#.. #..#. #...#",
    "C": ".###. #...# #.... #.... #.... #...# .###.",
    "W": "#...# #...# #...# #.#.# #.#.# ##.## #...#",
    "V": "#...# #...# #...# #...# #...# .#.#. ..#..",
    "-": "..... ..... ..... ##### ..... ..... .....",
    " ": "..... ..... ..... ..... ..... ..... .....",
}
CODES = {letter: code for code, letter in enumerate(ROWS)}
INK = np.array([[[mark == "#" for mark in row] for row in rows.split()] for rows in ROWS.values()], np.bool_)
PRODUCT = tuple(CODES[letter] for letter in "WV-28 ")
SQUARE_UM, ADVANCE = 2.2, 6.0  # of a letter's squares; squares from letter to letter
LEFT_UM, TOP_UM, LINE_UM = 7.0, 66.0, 28.0
LETTER_R, LETTER_C, SPACE = CODES["R"], CODES["C"], CODES[" "]


@fast_kernel
def product_letter(place: int) -> int:
    """Return the code of a letter of the product name; a space past its end."""
    return PRODUCT[place] if 0 <= place < len(PRODUCT) else SPACE


@fast_kernel
def place_letter(place: int, column: int, row: int) -> int:
    """Return the code of a letter of the die position, as in R07C06; digits are their own codes. Row -1 has none."""
    number = row if place < 3 else column
    digit = place % 3
    if place < 0 or place > 5 or row < 0:
        return SPACE
    if digit == 0:
        return LETTER_R if place == 0 else LETTER_C
    return number // 10 % 10 if digit == 1 else number % 10


@fast_kernel
def glyph(code: int, x: float, y: float, footprint: float) -> float:
    """Return the ink of one letter at x in [0, 5) and y in [0, 7), in squares, y from the top."""
    ink = 0.0
    for row in range(7):
        for column in range(5):
            if INK[code, row, column]:
                ink += rectangle(x - column, y - row, 0.0, 1.0, 0.0, 1.0, footprint)
    return ink


@fast_kernel
def two_lines(u: float, v: float, column: int, row: int, footprint: float) -> float:
    """Return the ink of the product name above the die position, in a block 92 um wide and 90 um high.

    (u, v) are from its corner.
    """
    first = v > 44.0
    x = (u - LEFT_UM) / SQUARE_UM
    y = ((TOP_UM if first else TOP_UM - LINE_UM) - v) / SQUARE_UM
    if x < -0.5 or x > 6 * ADVANCE or y < -0.5 or y > 7.5:
        return 0.0
    place = math.floor((x + 0.5) / ADVANCE)
    code = product_letter(place) if first else place_letter(place, column, row)
    return min(glyph(code, x - ADVANCE * place, y, footprint / SQUARE_UM), 1.0)
