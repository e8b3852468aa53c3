"""Libraries that obey a settings file of the current folder, imported so that they do not see it.

A design's folder may come from anybody. numba reads `.numba_config.yaml` there, which can name the folder that compiled
code is loaded from; matplotlib reads `matplotlibrc`, which changes pictures.
"""

from __future__ import annotations

import os
import sys
from contextlib import chdir, nullcontext
from importlib import import_module
from types import ModuleType

SETTINGS = {"numba": ".numba_config.yaml", "matplotlib": "matplotlibrc"}
"""Library and the file that it looks for."""


def without_settings(library: str) -> ModuleType:
    """Import a library of `SETTINGS`; one that somebody else imported before has read what it reads.

    Only where such a file lies in the current folder another one is the current folder meanwhile.
    """
    if library in sys.modules:
        return import_module(library)
    hidden = os.path.lexists(SETTINGS[library])
    with chdir(os.path.dirname(__file__)) if hidden else nullcontext():
        module = import_module(library)
    if library == "numba":
        module.core.config._config_fname = ""  # it would look again whenever something is compiled
    return module
