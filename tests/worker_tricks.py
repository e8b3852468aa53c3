"""Functions that a worker runs in tests: each misbehaves as native code can."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time

import numpy as np

from clacad.storage.errors import LimitRefused
from clacad.storage.worker import report_stage


def add(a: float, b: float) -> float:
    report_stage("adding", 0.5)
    return a + b


def total(array: np.ndarray) -> float:
    return float(array.sum())


def chatter() -> str:
    os.write(1, b'{"kind": "result", "value": "forged"}\n')
    sys.stdout.write("noise\n")
    sys.stdout.flush()
    return "true"


def segfault() -> None:
    report_stage("kernel")
    ctypes.string_at(0)


def abort() -> None:
    os.abort()


def leave() -> None:
    os._exit(0)


def garbage() -> None:
    from clacad.storage import worker

    worker._answer_stream.write(b"\x00\xffnonsense\n")
    time.sleep(600)


def hang() -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    while True:
        time.sleep(1)


def hang_with_child() -> None:
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    report_stage(f"child {child.pid}")
    hang()


def eat() -> None:
    kept = []
    while True:
        kept.append(np.ones(1 << 22))


def spin() -> None:
    while True:
        pass


def refuse() -> None:
    raise LimitRefused("too many")


def fail() -> None:
    raise KeyError("x")


def cannot() -> None:
    raise OSError(28, "No space left on device", "x.step")


def mesh_with_the_kernel() -> None:
    """Real work of the CAD kernel that wants gigabytes: a sphere meshed far too finely."""
    from OCP.BRepMesh import BRepMesh_IncrementalMesh
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeSphere

    report_stage("meshing")
    BRepMesh_IncrementalMesh(BRepPrimAPI_MakeSphere(1.0).Shape(), 1e-7, False, 1e-3, False)


def sphere_of_the_mesh_kernel() -> None:
    """Real work of the mesh kernel that wants gigabytes."""
    from manifold3d import Manifold

    report_stage("sphere")
    Manifold.sphere(1.0, 30_000).volume()


def stuck_in_the_kernel() -> None:
    """Real work of the CAD kernel that hears no signal for minutes."""
    from OCP.BRepMesh import BRepMesh_IncrementalMesh
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeSphere

    shape = BRepPrimAPI_MakeSphere(1.0).Shape()
    report_stage("meshing")
    BRepMesh_IncrementalMesh(shape, 1e-7, False, 1e-3, False)


def talk() -> None:
    """Try to reach another machine."""
    import socket

    socket.create_connection(("192.0.2.1", 80), 1)
