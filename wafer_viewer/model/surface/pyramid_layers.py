"""Layers that only the coarser levels of a pyramid have, and what each mean is taken over."""

from __future__ import annotations

EXTREMES = ("z_min_um", "z_max_um")
"""Lowest and highest measured height below a pixel."""
OF_ORIGIN, N_ORIGIN = ("z_um", "confidence"), "n_origin"
"""Layers that are means of the pixels with the best origin below a pixel, and the layer that counts these."""
OF_MEASURED = ("z_raw_um", "u_um")
"""Layers that only measured pixels have, of which they are means; `N_ORIGIN` counts them."""
OVERLAP, N_OVERLAP = "overlap_um", "n_overlap"
"""Layer that is the mean of the pixels measured by two fields, and the layer that counts these."""
GREY, N_COVERED = "all_in_focus", "n_covered"
"""Layer that is the mean of the covered pixels, and the layer that counts these."""
COUNTS = (N_ORIGIN, N_OVERLAP, N_COVERED)
