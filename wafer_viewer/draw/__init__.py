"""Pure pictures: maps to images, curves to SVG, surfaces to GLB tiles; for the page and for reports."""
