"""Sign and colour of each judgement; its word stands beside them."""

from __future__ import annotations

import viser

VERDICT_LOOKS = {
    "open": (viser.Icon.CIRCLE_DASHED, "ink3"),
    "accepted": (viser.Icon.CIRCLE_CHECK, "good"),
    "rejected": (viser.Icon.CIRCLE_X, "fault"),
}
