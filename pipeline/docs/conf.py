"""Settings of the site. `build.py` prepares the source folder and runs Sphinx."""

import os
from importlib.metadata import distribution

project = "magline"
author = "The magline authors"
copyright = author
release = os.environ["MAGLINE_VERSION"]
extensions = ["myst_parser", "sphinx_copybutton", "sphinx_design", "sphinx.ext.mathjax"]
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
# Code of the program's own formats, for which Pygments has no lexer.
suppress_warnings = ["misc.highlighting_failure"]
nitpicky = True

html_theme = "pydata_sphinx_theme"
html_title = f"magline {release}"
html_css_files = ["site.css"]
html_js_files = ["versions.js"]
templates_path = ["_templates"]
html_static_path = ["_static", str(distribution("sphinx-mathjax-offline").locate_file(
    "sphinx-mathjax-offline/static/mathjax/tex-svg-full.js"))]
mathjax_path = "tex-svg-full.js"
html_copy_source = False
html_show_sphinx = False
# Summaries of the results would have to be fetched, which browsers reject for pages that are opened as files.
html_show_search_summary = False
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "show_prev_next": True,
    "logo": {"text": "magline"},
    "header_links_before_dropdown": 7,
    "navbar_persistent": ["search-button"],
    "navbar_end": ["versions", "theme-switcher"],
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}
copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True
