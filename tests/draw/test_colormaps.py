"""The fixed colours, as people see them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from skimage.color import deltaE_ciede2000, rgb2lab

from wafer_viewer.draw.colormaps import DIVERGING, ORIGIN_COLOURS, table
from wafer_viewer.model.surface.height_map import Origin

EYES = {
    "all colours": np.eye(3),
    "red-blind": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "green-blind": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "blue-blind": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
"""What eyes make of linear light: Machado, Oliveira and Fernandes 2009, in full severity."""


def seen_by(eyes, colours):
    srgb = np.asarray(colours, float) / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    light = np.clip(linear @ np.transpose(EYES[eyes]), 0, 1)
    return rgb2lab(np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)[None])[0]


@pytest.mark.parametrize("eyes", EYES)
def test_no_two_origins_look_alike(eyes):
    assert set(ORIGIN_COLOURS) == set(Origin)
    shown = dict(zip(ORIGIN_COLOURS, seen_by(eyes, list(ORIGIN_COLOURS.values())), strict=True))
    apart = {(a.name, b.name): float(deltaE_ciede2000(shown[a], shown[b])) for a, b in combinations(shown, 2)}
    assert min(apart.values()) >= 12, min(apart, key=lambda pair: apart[pair])


@pytest.mark.parametrize("eyes", EYES)
def test_what_lies_above_and_below_zero_is_told_apart_by_all_eyes(eyes):
    shown = seen_by(eyes, table(DIVERGING))
    lightness = shown[:, 0]
    assert (np.diff(lightness[:120]) >= -0.3).all()
    assert (np.diff(lightness[136:]) <= 0.3).all()
    assert lightness[128] > 85
    assert abs(lightness[127] - lightness[128]) < 1
    apart = [float(deltaE_ciede2000(shown[127 - k], shown[128 + k])) for k in range(24, 128, 8)]
    assert min(apart) > 10
