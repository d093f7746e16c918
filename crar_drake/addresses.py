"""Where servers listen."""

import errno
import socket

from crar_drake.errors import CrarError

_MOST_WAITING = 32  # connections that nobody has taken yet


def listen(what: str, host: str = "127.0.0.1", port: int = 0) -> socket.socket:
    """A socket that listens.

    Args:
        what: "UDP", for datagrams, or "HTTP", for connections.
        host: of an interface; that of another one than the loopback lets everybody
            there move the robot. An address with colons, such as ::1, is one of IPv6.
        port: 0 takes one that is free.

    Raises:
        CrarError: nothing can listen there; it names the option, `--host` or `--port`,
            and what to do.
    """
    if not host:  # would be all interfaces
        raise CrarError("--host is empty; 0.0.0.0 listens at all interfaces")
    try:
        host.encode("idna")
    except UnicodeError as error:
        raise CrarError(f"--host: {host!r} is no address of a computer") from error
    if not 0 <= port < 65536:
        raise CrarError(f"--port: {port} must be from 0 to 65535")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    connects = what != "UDP"
    opened = socket.socket(family, (socket.SOCK_DGRAM, socket.SOCK_STREAM)[connects])
    try:
        if connects:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind((host, port))
        if connects:
            opened.listen(_MOST_WAITING)
    except OSError as error:
        opened.close()
        wrong_host = isinstance(error, socket.gaierror) or error.errno in (
            errno.EADDRNOTAVAIL,
            errno.EAFNOSUPPORT,
        )
        advice = (
            "--host must be an address of this computer, such as 127.0.0.1"
            if wrong_host
            else "choose another --port, or --port 0 for a free one"
        )
        why = error.strerror or error
        raise CrarError(f"{what} at {host}:{port}: {why}; {advice}") from error
    return opened


def in_words(host: str, port: int) -> str:
    """Host and port as one writes them: "[::1]:7670"."""
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
