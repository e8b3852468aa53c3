"""Header of one array of an untrusted .npz archive."""

from __future__ import annotations

import re
from tokenize import TokenError
from typing import IO, Any

import numpy as np

from clacad.base.text import array_lengths, printable


def array_head(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, Fortran order and type of the array that follows in the stream.

    Raises
    ------
    ValueError
        The stream holds no such header; the message is one line.
    """
    try:
        version = np.lib.format.read_magic(stream)
        read = (
            np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        )
        shape, fortran, kind = read(stream)
    except (ValueError, TypeError, SyntaxError, MemoryError, TokenError) as error:
        said = re.sub(
            r" on line \d+: <ast\.[^>]*>", "", str(error).partition("\n")[0]
        )  # an address differs from run to run
        raise ValueError(printable(said)[:160]) from None
    lengths = array_lengths(shape)
    if lengths is None:
        raise ValueError(f"its shape is {printable(str(shape))[:80]}, not whole numbers >= 0")
    return lengths, bool(fortran), kind
