"""Compensation of the browser's tone curve in baked colours.

The page's 3D engine, three.js, sends every material through the filmic curve of S. Hill's fit of the ACES reference
transforms (three.js, ``ACESFilmicToneMapping``): linear rgb / 0.6 -> input matrix -> (v (v + a) - b) / (v (c v + d) +
e) -> output matrix -> sRGB. A texture baked with the inverse is displayed in the intended colours. The inverse exceeds
1 for light colours; it is divided by `GAIN`, which the material multiplies back.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

GAIN = 3.0
"""Base colour factor required of the material of these textures."""

_EXPOSURE = 0.6
_INPUT = np.array([[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]])
_OUTPUT = np.array([[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]])
_A, _B, _C, _D, _E = 0.0245786, 0.000090537, 0.983729, 0.4329510, 0.238081
_WHITEST = 245
"""Lightest displayed grey; lighter ones would need a factor over GAIN."""
_MOST = 0.95
"""Upper limit of the curve, so that the inverse stays finite (it reaches 1 / _C only at infinity)."""


def to_texture(shown: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the texture that is displayed as `shown`, both sRGB uint8 [..., 3]; exact to 3 of 255 for Mako."""
    light = _linear_table()[np.minimum(shown, _WHITEST)]
    before_output = np.clip(light @ np.linalg.inv(_OUTPUT).T.astype(np.float32), 0, _MOST)
    texture = _inverse_curve(before_output) @ np.linalg.inv(_INPUT).T.astype(np.float32) * (_EXPOSURE / GAIN)
    return _to_srgb(texture)


def as_shown(texture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the displayed colours of a texture with base colour factor `GAIN`, for legends and tests."""
    v = (_linear_table()[texture] * (GAIN / _EXPOSURE)) @ _INPUT.T
    curve = (v * (v + _A) - _B) / (v * (_C * v + _D) + _E)
    return _to_srgb((curve @ _OUTPUT.T).astype(np.float32))


def _inverse_curve(y: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the positive root v of (1 - c y) v^2 + (a - d y) v - (b + e y) = 0."""
    p, q, r = 1 - _C * y, _A - _D * y, -(_B + _E * y)
    return ((-q + np.sqrt(q * q - 4 * p * r)) / (2 * p)).astype(np.float32)


@cache
def _linear_table() -> NDArray[np.float32]:
    """Return the linear light of every sRGB code."""
    s = np.arange(256, dtype=np.float64) / 255
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4).astype(np.float32)


def _to_srgb(linear: NDArray[np.float32]) -> NDArray[np.uint8]:
    # A table of 4096 entries instead of a power for each pixel: at most one code off in the darkest tones.
    return _srgb_table()[(np.clip(linear, 0, 1) ** 0.5 * 4095 + 0.5).astype(np.uint16)]


@cache
def _srgb_table() -> NDArray[np.uint8]:
    t = (np.arange(4096, dtype=np.float64) / 4095) ** 2
    s = np.where(t <= 0.0031308, t * 12.92, 1.055 * t ** (1 / 2.4) - 0.055)
    return (s * 255 + 0.5).astype(np.uint8)
