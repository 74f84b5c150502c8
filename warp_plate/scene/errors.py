"""The one kind of error that bad input raises."""


class SceneError(ValueError):
    """Bad input: one line that names the key or file at fault, its value and what would be right."""
