"""HTML of the import dialog: gaps, sources, doubts, the button and the command line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from wafer_viewer.gui.presenters import import_contents as words
from wafer_viewer.model.acquisition.image_source import ImageOptions
from wafer_viewer.model.file_contents import AxisChoice, Fact, FileContents, FrameFact
from wafer_viewer.model.surface_format import Reading

Z_UM = 2.5 * np.arange(11)
PEAKS_UM = (4.0, 9.0, 13.0, 17.0, 21.0)


def contents(missing: int | None = 5) -> FileContents:
    sharpness = np.exp(-((Z_UM[:, None] - np.array(PEAKS_UM)) ** 2) / 18)
    frames = [
        FrameFact(f"IMG_{k}.tif", float(z), tuple(row)) for k, (z, row) in enumerate(zip(Z_UM, sharpness, strict=True))
    ]
    if missing is not None:
        frames[missing] = FrameFact("", float(Z_UM[missing]))
    facts = (
        Fact("files", "11"),
        Fact("images", "11 of 2048 x 1536 px, 8 bits"),
        Fact("pixel size", "0.65 um", "OME PhysicalSizeX"),
        Fact("z step", "2.5 um", "names of the files"),
    )
    return FileContents(
        "board", "images", facts, tuple(frames), places_um=((0.0, 0.0),), field_um=(1331.2, 998.4), n_bytes=31_000_000
    )


def test_a_gap_is_named_in_the_files_the_note_the_foot_and_on_the_button():
    found = contents()
    assert "a frame is missing" in words.files_html(found, False)
    assert "1 frame is missing at +12.5\u202fµm." in words.notes_html(found)
    assert words.button_words(found, ImageOptions()) == "Import with the gap"
    foot = words.foot_html(found, Path("/data/board.wafer"), "wafer-viewer import board")
    assert "1 field, 10 frames and one gap" in foot
    assert "31\u202fMB" in foot
    assert words.button_words(contents(None), ImageOptions()) == "Import"


def test_the_pictures_support_an_order_with_one_peak_a_place_and_no_shuffled_one():
    found = contents(None)
    assert words.places_with_one_peak(found.frames) == (5, 5)
    order = words.order_html(found)
    assert "The pictures support this order." in order
    assert "the names of the files say it" in order
    shuffled = found.frames[::2] + found.frames[1::2]
    assert words.places_with_one_peak(shuffled)[0] < 3
    assert "support this order" not in words.order_html(replace(found, frames=shuffled))


def test_values_stand_with_their_sources_and_open_ones_with_their_tone():
    found = replace(
        contents(),
        facts=(Fact("pixel size", ""), Fact("z step", "3 um or 2.5 um", "given; names of the files")),
        unsettled=("pixel size", "z step"),
    )
    assert 'data-tone="attention"' in words.source_html(found, "pixel size", "Pixel, µm", False)
    both = words.source_html(found, "z step", "z step, µm", True)
    assert "3 µm or 2.5 µm: typed; names of the files" in both
    assert 'data-tone="fault"' in both
    stated = words.source_html(contents(), "pixel size", "Pixel, µm", False)
    assert 'data-value="0.65"' in stated
    assert "OME PhysicalSizeX" in stated
    assert ">typed<" in words.source_html(contents(), "pixel size", "Pixel, µm", True)
    assert words.why_not(found) == "the pixel size is missing, the z step has two values."


def test_a_channel_that_is_not_chosen_is_not_missing():
    found = replace(contents(), choices=(AxisChoice("channel", ("DAPI", "GFP")),), unsettled=("channel",), doubts=("",))
    assert words.why_not(found) == "the channel is not chosen."
    assert 'data-states="Channel" data-value="" data-tone="attention"' in words.facts_html(found)


@pytest.mark.parametrize(
    ("message", "shown"),
    [
        ("Give it with --pixel-um, the images do not say it.", "Give it under Pixel, the images do not say it."),
        ("Leave it: leave --z-step-um out, or give --overrule.", "Leave it: empty z step, or take the typed values."),
        ("Say which to take, as in --channel 'DAPI', or its number, from 0.", "Say which to take under Channel."),
        ("Import stopped at /a: the folder holds no images. Nothing was written.", "The folder holds no images."),
    ],
)
def test_messages_name_the_fields_of_the_dialog_instead_of_flags(message, shown):
    assert words.reason(message).strip() == shown


def test_the_command_line_makes_the_same_import():
    options = ImageOptions(pixel_um=0.65, numerical_aperture=0.45, channel="GFP", only="IMG_*.tif", as_listed=True)
    line = words.command_line([Path("/data/my board")], options, Reading(z_unit="nm"), Path("/data/board.wafer"))
    assert line == (
        "wafer-viewer import '/data/my board' --pixel-um 0.65 --na 0.45 --channel GFP --only 'IMG_*.tif' --as-listed "
        "--z-unit nm -o board.wafer"
    )


def test_names_of_files_are_text_in_the_html():
    found = replace(contents(None), left_out=("<b>.png",))
    assert "<b>.png" not in words.files_html(found, False)


def test_a_flag_without_a_field_in_the_dialog_is_left_as_it_is():
    text = "copy it there, or start the viewer with --browse /tmp."
    assert words.page_words(text) == text
    assert words.page_words("give it with --pixel-um") == "give it under Pixel"
