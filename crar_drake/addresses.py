"""Where servers listen."""

from __future__ import annotations

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
    if not 0 <= port < 65536:
        raise CrarError(f"--port: {port} must be from 0 to 65535")
