"""One telescopelet as a sequential prescription, for checks by a lens-design program: ZMX text, optiland
JSON.

`stations.left_out` lists what such a file cannot represent; the list is printed in the file and by the
export.
"""
