"""Import of libraries that read a settings file of the current folder, without that file.

A design's folder is untrusted. numba reads `.numba_config.yaml` there, which can name the folder that
compiled code is loaded from; matplotlib reads `matplotlibrc`, which changes pictures.
"""

from __future__ import annotations

import os
import sys
from contextlib import chdir, nullcontext
from importlib import import_module
from types import ModuleType

SETTINGS = {"numba": ".numba_config.yaml", "matplotlib": "matplotlibrc"}
"""Library → settings file that it looks for."""


def without_settings(library: str) -> ModuleType:
    """Import a library of `SETTINGS`; a library imported before keeps the settings it has read.

    The current folder changes during the import, but only where it contains such a file.
    """
    if library in sys.modules:
        return import_module(library)
    hidden = os.path.lexists(SETTINGS[library])
    with chdir(os.path.dirname(__file__)) if hidden else nullcontext():
        module = import_module(library)
    if library == "numba":
        module.core.config._config_fname = ""  # numba looks again at each compilation
    return module
