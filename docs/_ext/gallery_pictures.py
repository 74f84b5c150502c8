"""Pictures of the gallery that scripts write as PNG files instead of leaving them to Matplotlib."""

import shutil
from pathlib import Path

from sphinx_gallery.scrapers import figure_rst


def scrape(block, variables, gallery):
    """Move the PNG files beside a script into the gallery, and return the text that shows them."""
    names = []
    for path, name in zip(_files(variables), variables["image_path_iterator"], strict=False):
        shutil.move(path, name)
        names.append(name)
    return figure_rst(names, gallery["src_dir"])


def _files(variables):
    return sorted(Path(variables["src_file"]).parent.glob("*.png"))
