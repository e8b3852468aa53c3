"""Mesh files of sheets whose cells differ: judged by light through their triangles, mutants found out."""

from __future__ import annotations

import pytest
from test_aimed_files import DESIGN, aimed_elsewhere, checks_of, one_vertex_moved, wrong_pitch

import clacad
from clacad.formats.mesh.stl import write_stl
from clacad.mesh import tessellate

QUADS = 32
