"""Types of properties are read once for each kind of handle, and are those that viser reads."""

from __future__ import annotations

from typing import get_type_hints

import viser
from viser._assignable_props_api import AssignablePropsBase

from wafer_viewer.gui.security.server import open_server
from wafer_viewer.gui.widgets.controls import cache_prop_types, prop_types


def test_handles_share_the_types_of_their_kind_and_still_take_values():
    cache_prop_types()
    assert isinstance(AssignablePropsBase._prop_hints, property)
    server, _ = open_server("127.0.0.1", 0)
    try:
        one, two = server.gui.add_button("One"), server.gui.add_button("Two", icon=viser.Icon.CHECK)
        assert one._prop_hints is two._prop_hints is prop_types(type(one._impl.props))
        assert one._prop_hints == get_type_hints(type(one._impl.props))
        one.label = "Uno"
        assert (one.label, two.label) == ("Uno", "Two")
    finally:
        server.stop()
