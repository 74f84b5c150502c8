"""Warp kernels: the stencils, the time update, and the paths that step batches of plates through time.

Start with ``streaming``: it is the whole method in its plainest form, two launches a step and a thread a node. The
other paths compute the same numbers faster. Each gathers the spatial operator by itself; ``update`` is the time update
that all of them call, and the tests compare every path with plain NumPy plates.

Fields are batched tensors indexed [plate, row, column]. Column i is node i along x; row j + 1 is node j along y: one
row of zeros lies below and above the plate, and rows are padded with zeros to ``stride`` columns, so that a stencil may
read past every edge. All numbers are scaled, see ``update``. ``real`` is wp.float32 or wp.float64 throughout.
"""
