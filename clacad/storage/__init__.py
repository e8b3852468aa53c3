"""Files on disk whatever is in them: atomic writing, staging, zips of strangers, native work in a process of its own.

What a format says is in `formats`; what is written and when, in `exporting`.
"""
