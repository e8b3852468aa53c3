"""One telescopelet as a sequential prescription, for a second opinion by a lens-design program: ZMX text, optiland JSON.

What such a file cannot hold is told by `stations.left_out`, in the file and where the export is told.
"""
