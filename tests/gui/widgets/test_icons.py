"""Icons come from viser's archive, and viser's own widgets take them the quick way."""

from __future__ import annotations

import viser
import viser._gui_api
import viser._gui_handles
import viser._icons

from wafer_viewer.gui.widgets.html import quicken, svg

READ_BY_VISER = viser._icons.svg_from_icon


def test_an_icon_is_the_one_that_viser_reads():
    for name in (viser.Icon.CHECK, viser.Icon.RULER_MEASURE, viser.Icon.PLAYER_PLAY):
        assert svg(name) == READ_BY_VISER(name)


def test_viser_asks_here_wherever_it_draws_an_icon():
    quicken()
    assert {m.svg_from_icon for m in (viser._icons, viser._gui_api, viser._gui_handles)} == {svg}
