"""Where the page is served: address, port, certificate and token, and how that is told to others.

The port is the one of the robot file or the next free one. A process that comes back takes the one
that it had, so that open pages find it again.
"""

from __future__ import annotations

import ipaddress
import os
import secrets
import socket
import ssl
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from dashboard.web.guard import Rules
from runtime.hubs import address_file
from runtime.settings import RobotSettings
from runtime.settings_file import shown

TOKEN_VARIABLE = "MYOGRAFT_WEB_TOKEN"
SHORTEST = 16  # characters of a token
PORTS = 100  # that are tried


class PlaceError(RuntimeError):
    """The page cannot be served; says why and what helps."""


@dataclass(frozen=True, slots=True)
class Place:
    """A socket that listens, and what one has to know of it."""

    socket: socket.socket
    url: str
    rules: Rules
    certificate: str = ""
    key: str = ""
    told: str = ""  # url and token, as a person is told


def take_place(settings: RobotSettings, run_dir: Path, state_dir: Path) -> Place:
    """Listen where the robot file says.

    Raises:
        PlaceError: the address is not this host's, no port is free, the certificate is none, or
            the token that was given is too short.
    """
    web = settings.web
    certificate, key = (settings.beside(x) if x else None for x in (web.certificate, web.key))
    _check(certificate, key)
    address = ipaddress.ip_address(web.address)
    token = _given_token()
    note = address_file(run_dir, "web")
    listening = _listen(str(address), _ports(web.port, note))
    port = listening.getsockname()[1]
    name = _name(address)
    url = f"{'https' if web.certificate else 'http'}://{name}:{port}"
    told = url
    if not address.is_loopback and not token:
        file = state_dir / "token"
        token = _kept_token(file)
        told = f"{url} (the token is in {file})"
    note.write_text(told)
    return Place(
        socket=listening,
        url=url,
        rules=Rules(settings.name, token, web.names, anywhere=not address.is_loopback),
        certificate=str(certificate or ""),
        key=str(key or ""),
        told=told,
    )


def told_address(run_dir: str) -> str:
    """Where another robot's page is; "" when it has none."""
    with suppress(OSError):
        return address_file(run_dir, "web").read_text().partition(" ")[0]
    return ""


def _check(certificate: Path | None, key: Path | None) -> None:
    if certificate is None or key is None:
        return
    for what, file in (("certificate", certificate), ("key", key)):
        if not file.is_file():
            raise PlaceError(f"[web]: {what} file {shown(file)} does not exist")
    try:
        ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(certificate, key)
    except (ssl.SSLError, OSError) as error:
        what = f"{certificate} and {key} are no certificate with its key (PEM)"
        raise PlaceError(f"{what}: {error}; see [web]") from error


def _ports(first: int, note: Path) -> list[int]:
    ports = list(range(first, min(first + PORTS, 65_536)))
    with suppress(OSError, ValueError):
        had = urlsplit(note.read_text().partition(" ")[0]).port
        if had is not None:
            ports.insert(0, had)
    return ports


def _listen(address: str, ports: list[int]) -> socket.socket:
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    for port in ports:
        listening = socket.socket(family, socket.SOCK_STREAM)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listening.bind((address, port))
            listening.listen()
        except OSError as error:
            listening.close()
            last = error
        else:
            return listening
    where = f"{address}, ports {ports[0]} to {ports[-1]}"
    raise PlaceError(f"the page cannot be served at {where}: {last.strerror}; see [web]")


def _name(address: ipaddress.IPv4Address | ipaddress.IPv6Address) -> str:
    if address.is_loopback:
        return "localhost" if str(address) == "127.0.0.1" else _bracketed(address)
    return socket.gethostname() if address.is_unspecified else _bracketed(address)


def _bracketed(address: ipaddress.IPv4Address | ipaddress.IPv6Address) -> str:
    return f"[{address}]" if address.version == 6 else str(address)


def _given_token() -> str:
    token = os.environ.get(TOKEN_VARIABLE, "").strip()
    if 0 < len(token) < SHORTEST:
        what = f"{TOKEN_VARIABLE} has {len(token)} characters, {SHORTEST} are needed"
        advice = "python3 -c 'import secrets; print(secrets.token_urlsafe())'"
        raise PlaceError(f"{what}; make one by: {advice}")
    return token


def _kept_token(file: Path) -> str:
    """The token of this robot, made at its first start; nobody else may read it."""
    with suppress(OSError):
        if kept := file.read_text().strip():
            return kept
    file.parent.mkdir(parents=True, exist_ok=True)
    token = secrets.token_urlsafe(24)
    with os.fdopen(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as out:
        out.write(token)
    return token
