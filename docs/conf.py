"""Sphinx settings of the documentation site: ``sphinx-build -W docs build/site``."""

import os
import sys
from pathlib import Path

import warp_plate

sys.path.insert(0, str(Path(__file__).parent / "_ext"))
# Commands in tutorials are those of this environment.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
os.environ["COLUMNS"] = "80"

project = "warp-plate"
author = "the warp-plate authors"
copyright = f"2026, {author}"
version = release = warp_plate.__version__

extensions = [
    "myst_nb",
    "reference_pages",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
    "sphinx_copybutton",
    "sphinx_design",
]
exclude_patterns = ["examples/**", "gallery/**/*.ipynb", "**/sg_execution_times.rst", "sg_execution_times.rst"]

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 4
autodoc_default_options = {"members": True, "inherited-members": True}
templates_path = ["_templates"]
autosummary_generate = ["reference/python-api.rst"]
autodoc_typehints = "signature"
maximum_signature_line_length = 80
napoleon_numpy_docstring = False
napoleon_use_ivar = True

nb_execution_mode = "cache"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 120
nb_merge_streams = True

sphinx_gallery_conf = {
    "examples_dirs": "examples/gallery",
    "gallery_dirs": "gallery",
    "image_scrapers": ("matplotlib", "gallery_pictures.scrape"),
    "subsection_order": [
        f"examples/gallery/{name}" for name in ("plates", "drives", "searches", "results", "explanations")
    ],
    "capture_repr": (),
    "remove_config_comments": True,
    "show_memory": False,
    "show_signature": False,
    "download_all_examples": False,
    "abort_on_example_error": True,
}

copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

# Options such as --help keep their dashes.
smartquotes = False

html_theme = "pydata_sphinx_theme"
html_title = "warp-plate"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_theme_options = {"show_prev_next": False, "navigation_with_keys": False}
