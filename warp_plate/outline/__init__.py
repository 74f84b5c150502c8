"""The geometry of plates of any outline, in NumPy and without the scene."""
