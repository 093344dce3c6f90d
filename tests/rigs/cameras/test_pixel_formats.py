"""Pixel formats, against packing bit by bit as their standards describe it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wafer_viewer.model.errors import RigError
from wafer_viewer.rigs.cameras.base import PIXEL_FORMATS, decode_image, full_range


def bit_stream(values, bits):
    """The formats ending in p: all bits one after the other, lowest first."""
    whole = sum(v << (bits * i) for i, v in enumerate(values))
    return whole.to_bytes(-(-len(values) * bits // 8), "little")


def shared_byte(values, bits):
    """The formats ending in Packed: the upper 8 bits of two pixels, and between them a byte with the lower ones."""
    low, out = bits - 8, b""
    for first, *second in (values[i : i + 2] for i in range(0, len(values), 2)):
        mask = (1 << low) - 1
        out += bytes([first >> low, (first & mask) | ((second[0] & mask) << 4 if second else 0)])
        out += bytes([second[0] >> low]) if second else b""
    return out


def packed(name, values):
    bits = PIXEL_FORMATS[name].bits
    if name.endswith("Packed"):
        return shared_byte(values, bits)
    if name.endswith("p"):
        return bit_stream(values, bits)
    return np.array(values, np.uint8 if bits == 8 else "<u2").tobytes()


@pytest.mark.parametrize("name", PIXEL_FORMATS)
@given(data=st.data())
def test_every_value_comes_back(name, data):
    bits = PIXEL_FORMATS[name].bits
    rows, cols = data.draw(st.tuples(st.integers(1, 3), st.integers(1, 5)))
    values = data.draw(st.lists(st.integers(0, 2**bits - 1), min_size=rows * cols, max_size=rows * cols))
    image = decode_image(packed(name, values) + b"chunk", name, rows, cols)
    assert image.shape == (rows, cols)
    assert image.dtype == (np.uint8 if bits == 8 else np.uint16)
    spare = 0 if bits == 8 else 16 - bits
    assert (image.reshape(-1) >> spare).tolist() == values


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_white_is_the_largest_value_and_order_is_kept(bits):
    values = np.arange(2**bits, dtype=np.uint16)
    wide = full_range(values, bits)
    assert wide[0] == 0
    assert wide[-1] == np.iinfo(wide.dtype).max
    assert (np.diff(wide.astype(int)) > 0).all()


def test_unknown_formats_and_short_buffers_are_refused():
    with pytest.raises(RigError, match=r"'RGB8' cannot be read: choose one of Mono8, .*Mono12Packed"):
        decode_image(b"", "RGB8", 1, 1)
    with pytest.raises(RigError, match="sent 5 bytes for 2 x 2 pixels in Mono12p, which take 6"):
        decode_image(bytes(5), "Mono12p", 2, 2)
