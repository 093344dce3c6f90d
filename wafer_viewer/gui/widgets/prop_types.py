"""Cached property types of viser handles: viser evaluates them again for each handle."""

from __future__ import annotations

import functools
from typing import Any, get_type_hints

from viser import _assignable_props_api as api


@functools.cache
def prop_types(props: type) -> dict[str, Any]:
    """Return the type of each property by name."""
    return get_type_hints(props)


def cache_prop_types() -> None:
    """Make viser use the cached types: half of the server's work to build a page. Pinned to viser 1.1."""
    hints = property(lambda handle: prop_types(type(handle._impl.props)))
    api.AssignablePropsBase._prop_hints = hints  # pyright: ignore[reportAttributeAccessIssue]
