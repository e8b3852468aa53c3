"""Judgement of files: a file is found, placed, and judged by wholeness, shape and light.

`judge_files` is the entry. Meshes, solids and maps have a module each. A part without a manifest is first
registered.
"""
