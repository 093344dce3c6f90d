"""Charts and maps as SVG or HTML."""
