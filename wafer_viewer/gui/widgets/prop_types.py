"""Types of the properties of viser's handles, read once for each kind: viser reads them anew for each handle."""

from __future__ import annotations

import functools
from typing import Any, get_type_hints

from viser import _assignable_props_api as api


@functools.cache
def prop_types(props: type) -> dict[str, Any]:
    """The type of each property by its name."""
    return get_type_hints(props)


def cache_prop_types() -> None:
    """Have viser take the types from here: half of what the server computes to make a page. Pinned to viser 1.1."""
    hints = property(lambda handle: prop_types(type(handle._impl.props)))
    api.AssignablePropsBase._prop_hints = hints  # pyright: ignore[reportAttributeAccessIssue]
