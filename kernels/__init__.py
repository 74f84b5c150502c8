"""Warp code and nothing else: the stencil, the equation of motion, and the paths that step it through time.

Every path keeps one batched grid tensor per quantity, indexed [plate, row, column]. Column i is node i along x;
row j + 1 is node j along y: one row of zeros lies below and above the plate, and at least two columns of zeros
to its right, so that a stencil may read past every edge. All numbers are scaled (see ``update``).
"""
