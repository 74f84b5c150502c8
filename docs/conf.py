"""Sphinx settings of the documentation site: ``sphinx-build -W docs build/site``."""

import warp_plate

project = "warp-plate"
author = "the warp-plate authors"
copyright = f"2026, {author}"
version = release = warp_plate.__version__

extensions = [
    "myst_parser",
    "sphinx_copybutton",
    "sphinx_design",
]
exclude_patterns = ["examples/*.md"]

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 4
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

html_theme = "pydata_sphinx_theme"
html_title = "warp-plate"
html_theme_options = {"show_prev_next": False, "navigation_with_keys": False}
