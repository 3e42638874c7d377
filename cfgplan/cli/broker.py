"""Options for the connection to an MQTT broker, shared by the commands that have one."""

from __future__ import annotations

import argparse

_CONNECTION = (
    ("username", "NAME", "the user name at the broker"),
    ("password_env", "VARIABLE", "the environment variable that holds the password"),
    ("password_file", "FILE", "the file that holds the password"),
    ("ca", "FILE", "TLS: certificate of the authority to trust (PEM)"),
    ("certificate", "FILE", "TLS: certificate of this client (PEM)"),
    ("key", "FILE", "TLS: private key of this client's certificate (PEM)"),
)


def add_connection(group: argparse._ActionsContainer, before: str = "") -> None:
    """Add an option for each parameter of a connection, its name with `before` in front."""
    for name, metavar, means in _CONNECTION:
        group.add_argument(f"--{before}{name.replace('_', '-')}", metavar=metavar, help=means)


def connection(options: argparse.Namespace, before: str = "") -> dict[str, str]:
    """The parameters of a connection that are given."""
    given = {name: getattr(options, f"{before}{name}".replace("-", "_")) for name, _, _ in _CONNECTION}
    return {name: value for name, value in given.items() if value is not None}
