"""Where servers listen."""

import errno
import socket

from crar_drake.errors import CrarError


def check_address(host: str, port: int) -> None:
    """Refuses what is no interface, and what is no port.

    Args:
        host: of an interface.
        port: 0 takes one that is free.

    Raises:
        CrarError: names the option, `--host` or `--port`.
    """
    if not host:  # would be all interfaces
        raise CrarError("--host is empty; 0.0.0.0 listens at all interfaces")
    try:
        host.encode("idna")
    except UnicodeError as error:
        raise CrarError(f"--host: {host!r} is no address of a computer") from error
    if not 0 <= port < 65536:
        raise CrarError(f"--port: {port} must be from 0 to 65535")


def family_of(host: str) -> socket.AddressFamily:
    """IPv6 of an address with colons, such as ::1, else IPv4."""
    return socket.AF_INET6 if ":" in host else socket.AF_INET


def cannot_listen(what: str, host: str, port: int, error: OSError) -> CrarError:
    """The error that says why nothing can listen there, and what to do.

    Args:
        what: listens, such as "UDP".
        host, port: where it should.
    """
    wrong_host = isinstance(error, socket.gaierror) or error.errno in (
        errno.EADDRNOTAVAIL,
        errno.EAFNOSUPPORT,
    )
    advice = (
        "--host must be an address of this computer, such as 127.0.0.1"
        if wrong_host
        else "choose another --port, or --port 0 for a free one"
    )
    return CrarError(f"{what} at {host}:{port}: {error.strerror or error}; {advice}")
