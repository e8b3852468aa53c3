"""Every Python that a test starts, and every one that those start: nothing may leave this machine.

Found by PYTHONPATH. What is tried is refused, and noted in the file that CLACAD_NETWORK_LOG names, so that code
which swallows the refusal is found out too.
"""

from __future__ import annotations

import os
import sys

NAMES = {"", "localhost", "localhost.localdomain", "ip6-localhost"}


def local(address: object) -> bool:
    """Whether an address is a Unix socket or a number of this machine, not an address elsewhere."""
    if not isinstance(address, tuple):
        return True
    host = address[0].decode("ascii", "replace") if isinstance(address[0], bytes) else str(address[0] or "")
    return host in NAMES or host == "::1" or host.startswith("127.") or host in ("0.0.0.0", "::")


def watch(event: str, arguments: tuple[object, ...]) -> None:
    """Refuse connections, datagrams and name look-ups that lead elsewhere."""
    if not event.startswith("socket."):
        return
    if event in ("socket.connect", "socket.sendto", "socket.sendmsg"):
        address = arguments[1]
    elif event in ("socket.getaddrinfo", "socket.gethostbyname", "socket.gethostbyaddr"):
        address = (arguments[0],)
    else:
        return
    if address is None or local(address):
        return
    log = os.environ.get("CLACAD_NETWORK_LOG")
    if log:
        with open(log, "a", encoding="utf-8") as stream:
            stream.write(f"{event} {address} by {sys.argv}\n")
    raise RuntimeError(f"{event} {address}: tests talk to no other machine")


if (
    sys.platform != "win32"
):  # audit hooks last forever: only children of the tests have this module on their path
    sys.addaudithook(watch)
