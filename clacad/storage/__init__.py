"""Files on disk, independent of their format: atomic writing, staging, untrusted zips, a worker for native
code.

File formats are defined in `formats`; `exporting` decides what is written and when.
"""
