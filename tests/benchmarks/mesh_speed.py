"""Facets a second and memory of the mesh of a large sheet: python tests/benchmarks/mesh_speed.py [cells] [quads ...]."""

from __future__ import annotations

import resource
import sys
import time

import clacad
from clacad.mesh import check_closed, mesh_body

DESIGN = {
    "format": 1,
    "name": "speed",
    "unit": "m",
    "law": {"eta": [-0.25, -1.0], "euler": [20.0, 1.0, 0.0]},
    "pair": {"form": "biconvex", "separation": 0.05, "index": 1.5},
    "lattice": {"kind": "square", "pitch": 0.005, "count": [1, 1]},
}


def main(cells: int = 200, quads: tuple[int, ...] = (8, 32)) -> None:
    """Print one line for each number of quads: facets, seconds to prepare, facets a second, peak memory."""
    window = clacad.prescribe(clacad.Design.from_dict(DESIGN)).with_cells((cells, cells))
    sys.stdout.write("quads      facets  prepare s   Mfacets/s  peak MB\n")
    for number in quads:
        start = time.process_time()
        body = mesh_body(window, window.bodies[0], number)
        facets = body.facet_count
        prepared = time.process_time()
        streamed = sum(len(block) for block in body.rows())
        seconds = time.process_time() - prepared
        assert streamed == facets
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        sys.stdout.write(
            f"{number:5d} {facets:11d} {prepared - start:10.2f} {facets / seconds / 1e6:11.2f} {peak:8.0f}\n"
        )
    body = mesh_body(window, window.bodies[0], quads[0])
    start = time.process_time()
    health = check_closed(body.rows)
    seconds = time.process_time() - start
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    sys.stdout.write(
        f"examined {health.triangles} facets in {seconds:.1f} s, {peak:.0f} MB: {health.closed}, {health.pieces} pieces\n"
    )


if __name__ == "__main__":
    arguments = [int(value) for value in sys.argv[1:]]
    main(*(arguments[:1] or [200]), quads=tuple(arguments[1:]) or (8, 32))
