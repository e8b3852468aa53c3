"""`python -m clacad` and the `clacad` script."""

from __future__ import annotations

import os
import sys


def main() -> None:
    """Run the command line and leave with its status."""
    status = None
    # matrices are small here: more threads of linear algebra only wait for one another
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        import signal

        from clacad.cli.entry_point import main as run

        status = run()
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # all is done and printed: nothing is left to interrupt
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), signal.SIG_IGN)
    except KeyboardInterrupt:  # while the lines above were read
        if status is None:
            sys.stderr.write("clacad: interrupted\n")
        status = 130
    if status == 130:  # threads of libraries that still compute are not waited for
        os._exit(status)
    sys.exit(status)


if __name__ == "__main__":
    main()
