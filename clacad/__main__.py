"""`python -m clacad` and the `clacad` script."""

from __future__ import annotations

import os
import sys


def main() -> None:
    """Run the command line and leave with its status."""
    try:
        import signal

        from clacad.cli.run import INTERRUPTED
        from clacad.cli.run import main as run

        status = run()
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # all is done and said: nothing is left to interrupt
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), signal.SIG_IGN)
        if status == INTERRUPTED:  # all is cleaned up; threads of libraries that still compute are not waited for
            os._exit(status)
    except KeyboardInterrupt:  # while the lines above were read
        sys.stderr.write("clacad: interrupted\n")
        os._exit(130)
    sys.exit(status)


if __name__ == "__main__":
    main()
