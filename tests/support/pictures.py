"""Pictures and pages: their pixels, and a mouse."""

import numpy as np


def pixels(picture):
    """Return the (height, width, 3) colours 0 … 255 of a picture's path or file object."""
    from PIL import Image

    return np.asarray(Image.open(picture).convert("RGB"), dtype=int)


def drag(page, selector, x, y=0):
    """Drag the middle of an element of a page by a distance [pixels]."""
    box = page.locator(selector).last.bounding_box()
    start = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(*start)
    page.mouse.down()
    page.mouse.move(start[0] + x, start[1] + y, steps=5)
    page.mouse.up()
