"""The table ``[links]``: names for keys that belong together and hold one number, such as all springs of a gasket."""

from typing import Annotated

from pydantic import Field

from warp_plate.scene.fields import Name, Table


class Link(Table):
    """Keys that hold one number. The name of the link is a key too: it is set, varied and fitted as one."""

    keys: Annotated[
        tuple[Name, ...], Field(min_length=1, examples=[["edges.left.translation", "edges.right.translation"]])
    ]
    """Keys of the panel (plate, edges, effects, piezo patches, measurements) that hold the same number."""
