"""Configuration of the documentation's site, which ``wafer-viewer docs --build`` writes to ``assets/docs/_build/html``.

WAFER_VIEWER_GALLERY=no leaves the examples as text, without running them.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from wafer_viewer._version import __version__

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))
os.environ.setdefault("MPLBACKEND", "agg")

project = "Wafer Viewer"
author = "The Wafer Viewer developers"
copyright = "The Wafer Viewer developers, BSD-3-Clause"
version = release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
    "command_pages",
    "struct_fields",
]
exclude_patterns = ["_build"]
templates_path = ["_templates"]
nitpicky = True
smartquotes = False  # "--host" would become a dash
# Types of other packages: their inventories are not at hand when the site is built offline.
nitpick_ignore_regex = [("py:.*", r"(?!wafer_viewer\.).*"), ("py:.*", r"wafer_viewer\.\w+\..*")]
suppress_warnings = ["config.cache"]

myst_heading_anchors = 3
myst_enable_extensions = ["colon_fence"]
autosummary_generate = True
autodoc_typehints = "none"
autodoc_preserve_defaults = True
maximum_signature_line_length = 100
autodoc_class_signature = "mixed"
numpydoc_show_class_members = False
copybutton_prompt_text = "$ "

EXAMPLES = HERE / "_build" / "examples"
"""Copy in which the examples run, so that nothing they write lands in the sources."""
RUNS_EXAMPLES = os.environ.get("WAFER_VIEWER_GALLERY", "yes") == "yes"


def prepare_examples() -> None:
    """Copy the examples, and make the scan that several of them open."""
    shutil.copytree(HERE.parent / "examples", EXAMPLES, dirs_exist_ok=True)
    scan = EXAMPLES / "scan.wafer"
    if RUNS_EXAMPLES and not (scan / "results").exists():
        shutil.rmtree(scan, ignore_errors=True)
        for words in (["scan", HERE.parent / "plans/wafer.toml", "-o", scan], ["stitch", scan]):
            subprocess.run([sys.executable, "-m", "wafer_viewer", *words], check=True, stdout=subprocess.DEVNULL)


prepare_examples()
sphinx_gallery_conf = {
    "examples_dirs": str(EXAMPLES),
    "gallery_dirs": "gallery",
    "filename_pattern": r"/\d\d_",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 60,
    "write_computation_times": False,
    "remove_config_comments": True,
    "plot_gallery": RUNS_EXAMPLES,
}

html_theme = "pydata_sphinx_theme"
html_title = f"Wafer Viewer {__version__}"
html_context = {"default_mode": "auto"}
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sourcelink = False
html_show_search_summary = False  # it fetches pages, which neither a file nor the policy of the page allows
html_theme_options = {
    "navbar_start": ["navbar-logo"],
    "navbar_end": ["theme-switcher"],
    "header_links_before_dropdown": 7,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_prev_next": True,
    "collapse_navigation": True,
}
html_sidebars = {"index": []}
