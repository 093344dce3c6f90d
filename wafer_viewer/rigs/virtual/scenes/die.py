"""One die from above: bevel, rim, seal ring, bond pads, core, and its lettering.

(u, v) are um from the die's lower left corner. Every part returns (radiance, rise_um, contrast): the mean brightness as
a share of white, the height over the die's top, and the strength of the grain, which provides the focus signal.
"""

from __future__ import annotations

import math

import numpy as np

from wafer_viewer.numerics.jit import fast_part
from wafer_viewer.rigs.virtual.scenes.drawing import bar, bars, blend, chance, inside, rectangle

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


@fast_part
def product_letter(place: int) -> int:
    """Return the code of a letter of the product name; a space past its end."""
    return PRODUCT[place] if 0 <= place < len(PRODUCT) else SPACE


@fast_part
def place_letter(place: int, column: int, row: int) -> int:
    """Return the code of a letter of the die position, as in R07C06; digits are their own codes. Row -1 has none."""
    number = row if place < 3 else column
    digit = place % 3
    if place < 0 or place > 5 or row < 0:
        return SPACE
    if digit == 0:
        return LETTER_R if place == 0 else LETTER_C
    return number // 10 % 10 if digit == 1 else number % 10


@fast_part
def glyph(code: int, x: float, y: float, footprint: float) -> float:
    """Return the ink of one letter at x in [0, 5) and y in [0, 7), in squares, y from the top."""
    ink = 0.0
    for row in range(7):
        for column in range(5):
            if INK[code, row, column]:
                ink += rectangle(x - column, y - row, 0.0, 1.0, 0.0, 1.0, footprint)
    return ink


@fast_part
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


WIDTH_UM, HEIGHT_UM = 456.0, 336.0
BEVEL_UM, BEVEL_SLOPE = 5.0, 0.6
RIM_UM, SEAL_UM = 19.0, 33.0
PAD_UM, PAD_PITCH_UM, PADS = 28.0, 38.0, 10
PAD_LEFT_UM, PAD_ROW_UM = 43.0, 40.0
CORE_LEFT_UM, CORE_BOTTOM_UM = 44.0, 78.0
BLOCK_WIDTH_UM, BLOCK_HEIGHT_UM = 92.0, 90.0
SILICON = 0.13  # radiance of the bare die
MEMORY, LINES_UP, LOGIC, BLANK, LOGIC_2, LETTERS, LINES_ACROSS, MEMORY_2 = range(8)

# Salts, as numpy integers: numba would compile the noise anew for every literal one.
MARK_X, MARK_Y = np.arange(11, 13)


@fast_part
def die(u: float, v: float, column: int, row: int, inset: float, footprint: float) -> tuple[float, float, float]:
    """Return (radiance, rise_um, contrast) of the die at (u, v).

    inset: distance from the die's edge, which chips may have reduced.
    """
    if inset < RIM_UM:
        return rim(inset)
    if inset < SEAL_UM:
        return seal_ring(inset, footprint)
    from_row = min(v, HEIGHT_UM - v) - PAD_ROW_UM
    if -1.0 <= from_row <= PAD_UM + 1.0:
        return pad(u, from_row, column, row * 2 + (v > HEIGHT_UM / 2), footprint)
    return core(u - CORE_LEFT_UM, v - CORE_BOTTOM_UM, column, row, footprint)


@fast_part
def bevel_drop(inset: float) -> float:
    """Return the depth of the sawn edge below the die's top in um."""
    return BEVEL_SLOPE * max(0.0, BEVEL_UM - abs(inset))


@fast_part
def rim(inset: float) -> tuple[float, float, float]:
    """Return (radiance, rise_um, contrast) of the sawn bevel and the bare rim inside it, dark and without grain."""
    return blend(0.022, 0.045, inside(inset - BEVEL_UM, 2.0)), -bevel_drop(inset), 0.0


@fast_part
def seal_ring(inset: float, footprint: float) -> tuple[float, float, float]:
    """Return (radiance, rise_um, contrast) of two metal lines around the die."""
    metal = bar(inset, 21.0, 23.6, footprint) + bar(inset, 26.5, 29.1, footprint)
    return 0.075 + 0.42 * metal, 0.6 * metal, 0.03 + 0.08 * metal


@fast_part
def pad(u: float, v: float, column: int, row: int, footprint: float) -> tuple[float, float, float]:
    """Return (radiance, rise_um, contrast) of a row of bond pads; v from the bottom of the row.

    Each pad has a probe mark at a different position.
    """
    number = math.floor((u - PAD_LEFT_UM) / PAD_PITCH_UM)
    if number < 0 or number >= PADS:
        return SILICON, 0.0, 0.03
    x = u - PAD_LEFT_UM - number * PAD_PITCH_UM
    metal = rectangle(x, v, 0.0, PAD_UM, 0.0, PAD_UM, footprint)
    frame = metal - rectangle(x, v, 2.2, PAD_UM - 2.2, 2.2, PAD_UM - 2.2, footprint)
    mark = probe_mark(x, v, number, column * 7 + row, footprint)
    radiance = blend(SILICON, (0.56 + 0.10 * frame) * (1.0 - 0.62 * mark), metal)
    return radiance, (0.9 - 0.5 * mark) * metal, 0.03 + 0.06 * metal + 0.12 * mark


@fast_part
def probe_mark(x: float, y: float, number: int, salt: int, footprint: float) -> float:
    """Return the coverage of the elliptical mark of a probe needle near the centre of a pad."""
    across = (x - PAD_UM / 2 - 6.0 * (chance(number, salt, MARK_X) - 0.5)) / 3.2
    along = (y - PAD_UM / 2 - 5.0 * (chance(number, salt, MARK_Y) - 0.5)) / 7.5
    return inside(3.0 * (1.0 - math.sqrt(across * across + along * along)), footprint)


@fast_part
def core(u: float, v: float, column: int, row: int, footprint: float) -> tuple[float, float, float]:
    """Return (radiance, rise_um, contrast) of the core: four by two blocks, each within a thin bright border.

    (u, v) are from the corner of the core.
    """
    across, up = math.floor(u / BLOCK_WIDTH_UM), math.floor(v / BLOCK_HEIGHT_UM)
    if across < 0 or across > 3 or up < 0 or up > 1:
        return SILICON, 0.0, 0.08
    x, y = u - across * BLOCK_WIDTH_UM, v - up * BLOCK_HEIGHT_UM
    kind = int(across + 4 * up)
    within = rectangle(x, y, 3.0, 89.0, 3.0, 87.0, footprint)
    if kind == BLANK:
        return blend(SILICON, 0.105, within), 0.0, blend(0.055, 0.003, within)
    radiance, rise_um, contrast = pattern(kind, x, y, column, row, footprint)
    ground = 0.115 if kind == LETTERS else SILICON
    return ground + radiance * within + border(x, y, footprint), rise_um * within, contrast


@fast_part
def border(x: float, y: float, footprint: float) -> float:
    """Return the radiance of the thin line along the left and lower side of a block."""
    left = rectangle(x, y, 0.8, 2.2, 0.8, 89.2, footprint)
    lower = rectangle(x, y, 2.2, 91.2, 0.8, 2.2, footprint)
    return 0.10 * (left + lower)


@fast_part
def pattern(kind: int, x: float, y: float, column: int, row: int, footprint: float) -> tuple[float, float, float]:
    """Return the pattern of a block: (radiance over the ground, rise_um, contrast)."""
    soft = max(footprint, 0.7)  # lithography is no sharper than this
    if kind == LETTERS:
        ink = two_lines(x, y, column, row, footprint)
        return 0.45 * ink, 0.8 * ink, 0.08
    if kind in (MEMORY, MEMORY_2):
        cells = memory(x, y, soft)
        return 0.20 * cells, 0.25 * cells, 0.055
    if kind == LINES_UP:
        lines = bars(x, 5.0, 0.5, soft)
        return 0.15 * lines, 0.3 * lines, 0.055
    if kind == LINES_ACROSS:
        lines = bars(y, 7.0, 0.5, soft)
        return 0.13 * lines, 0.3 * lines, 0.055
    wires = logic(x, y, kind, soft)
    return 0.24 * wires, 0.3 * wires, 0.055


@fast_part
def memory(x: float, y: float, soft: float) -> float:
    """Return the coverage by staggered cells, their word lines, and occasional column straps."""
    stagger = 3.6 * (math.floor(x / 5.2) % 2)
    cells = bars(x, 5.2, 0.5, soft) * bars(y + stagger, 7.2, 0.55, soft)
    return 0.8 * cells + 0.35 * bars(y, 7.2, 0.16, soft) + 0.4 * bars(x, 26.0, 0.07, soft)


@fast_part
def logic(x: float, y: float, salt: int, soft: float) -> float:
    """Return the coverage by rows of standard cells, randomly present bars between supply rails."""
    row = math.floor(y / 6.0)
    up = y - 6.0 * row
    strength = 0.5 + 0.5 * chance(math.floor(x / 9.6), row, salt + 31)
    return cell_bars(x, row, salt, soft) * bar(up, 1.3, 5.2, soft) * strength + 0.7 * bar(up, 0.0, 0.9, soft)


@fast_part
def cell_bars(x: float, row: int, salt: int, soft: float) -> float:
    """Return the coverage by bars 2.4 um wide, present or absent, with soft transitions between them."""
    number = math.floor(x / 2.4)
    along = x - 2.4 * number
    before, here, after = (
        is_bar_present(number - 1, row, salt),
        is_bar_present(number, row, salt),
        is_bar_present(number + 1, row, salt),
    )
    return blend(blend(before, here, inside(along, soft)), after, inside(along - 2.4, soft))


@fast_part
def is_bar_present(number: int, row: int, salt: int) -> float:
    """Return 1 where there is a bar, otherwise 0."""
    return 1.0 if chance(number, row, salt) > 0.5 else 0.0
