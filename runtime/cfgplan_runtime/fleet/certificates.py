"""A fleet's own certificate authority, a certificate for each of its hosts, and the resulting rights of links.

All are made on one computer: a folder with the authority, and in it a folder for each host, which is copied there. The
authority's key stays where it was made. Both sides of a link verify certificates (TLS). A host's name is that of its
certificate, and it may write only below its own keys.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from cfgplan.domain import MANAGER
from cfgplan.errors import Fault, InputError
from cfgplan_runtime.streams.crossing import KEYS, host_key
from cfgplan_runtime.supervision.events import CertificateEnds

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric import ec

_AUTHORITY_CERTIFICATE, _AUTHORITY_KEY = "authority.pem", "authority.key"
_CERTIFICATE, _KEY, _ACCESS = "host.pem", "host.key", "access.json"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,62}")
_CLOCKS_DIFFER = timedelta(hours=1)
"""A certificate is valid from this long before it was made, since the clocks of hosts differ."""
_AUTHORITY_DAYS = 3650


_SOON = timedelta(days=30)
"""The time before the end of a certificate from which a warning is given once a day."""
_ANEW = "make a new folder by `cfgplan certificates` where the authority is, copy it here, and start again"


class _Access(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The hosts of the fleet, and those of them that may pass on messages of others."""

    hosts: tuple[str, ...]
    passing_on: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Authority:
    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey


class Validity:
    """The time for which a host's folder gives it access: until its certificate ends, or that of its authority.

    A link keeps the certificates that the folder had when the link was made. `name` is that of the host. Raises
    InputError.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self._name, self._file = name, folder / _CERTIFICATE
        self._ends = min(map(_end_of, (self._file, folder / _AUTHORITY_CERTIFICATE)))
        self._due = datetime.now(UTC)

    def tell_again(self) -> None:
        """Repeat the warning, for a listener that has not got it."""
        self._due = datetime.now(UTC)

    def warning(self) -> CertificateEnds | None:
        """The event to report now, at most once a day; None if none is due. Raises InputError once the certificate has
        ended.
        """
        now = datetime.now(UTC)
        if now < min(self._due, self._ends):
            return None
        self._due = now + timedelta(days=1)
        refuse_ended(self._file, self._ends)
        left = self._ends - now
        return CertificateEnds(self._name, f"{self._ends:%Y-%m-%d %H:%M} UTC", left.days) if left < _SOON else None


def ending(event: CertificateEnds) -> str:
    """A sentence about a certificate that ends soon."""
    days = f"{event.days_left} day{'s' if event.days_left != 1 else ''} left"
    return f"the certificate of {event.host} ends on {event.ends} ({days}): {_ANEW}"


def refuse_ended(file: Path, ends: datetime) -> None:
    """Raise InputError if a certificate has ended."""
    if ends <= datetime.now(UTC):
        raise InputError.of(f"this certificate was valid until {ends:%Y-%m-%d %H:%M} UTC", file=str(file), mend=_ANEW)


def make(folder: Path, hosts: Mapping[str, Sequence[str]], *, passing_on: Iterable[str] = (), days: int) -> list[Path]:
    """Make a folder for each host (name -> its DNS names and addresses) and for the manager. Returns the new folders.

    The manager, which gives orders, has a certificate too, and may run on any host that has a copy of its folder.

    The authority is made if the folder has none. Otherwise the hosts are added to its fleet: the list of hosts in every
    host's folder is replaced, and no other file is overwritten. Only their owner can read the files. Raises InputError.
    """
    _refuse_names([*hosts, *passing_on, *(one for each in hosts.values() for one in each if not _is_address(one))])
    if not 1 <= days <= _AUTHORITY_DAYS:
        raise InputError.of(f"certificates can't be valid for {days} days", mend=f"1 to {_AUTHORITY_DAYS}")
    try:
        known = [path.parent.name for path in sorted(folder.glob(f"*/{_ACCESS}"))]
        names = [*hosts, *([] if MANAGER in known else [MANAGER])]
        _refuse_overwriting(folder / name for name in names)
        listed = tuple(sorted({*known, *names}))
        passing = {*passing_on, *(_access(folder / known[0]).passing_on if known else ())}
        if unknown := sorted(passing - set(listed)):
            raise InputError.of(f"{', '.join(unknown)}: no such host", mend=f"hosts are {', '.join(listed)}")
        access = msgspec.json.encode(_Access(listed, tuple(sorted(passing))))
        authority = _authority(folder)
        for name in names:
            _make_host(folder / name, authority, (name, *hosts.get(name, ())), days)
        for name in listed:
            with suppress(FileNotFoundError):
                (folder / name / _ACCESS).unlink()
            _write(folder / name / _ACCESS, access)
    except OSError as error:
        raise InputError.unwritable(error, str(error.filename or folder)) from None
    return [folder / name for name in names]


def keys_of(host: str) -> str:
    """The keys below which only this host may put, answer or be alive. Every host of the fleet may listen to them."""
    return f"{host_key(host)}/**"


def tls(folder: Path) -> dict[str, Any]:
    """Zenoh's `transport/link/tls` of the host whose folder it is. Raises InputError."""
    files = {name: folder / name for name in (_AUTHORITY_CERTIFICATE, _CERTIFICATE, _KEY)}
    if missing := sorted(name for name, path in files.items() if not path.is_file()):
        mend = "copy the host's folder that `cfgplan certificates` has made"
        raise InputError([Fault("there is no such file", file=str(folder / name), mend=mend) for name in missing])
    for file in (_CERTIFICATE, _AUTHORITY_CERTIFICATE):
        refuse_ended(files[file], _end_of(files[file]))
    sides = {"listen": (_KEY, _CERTIFICATE), "connect": (_KEY, _CERTIFICATE)}
    return {
        "root_ca_certificate": str(files[_AUTHORITY_CERTIFICATE]),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
        **{f"{side}_private_key": str(files[key]) for side, (key, _) in sides.items()},
        **{f"{side}_certificate": str(files[certificate]) for side, (_, certificate) in sides.items()},
    }


def shown(folder: Path) -> tuple[Path, Path]:
    """The certificate of the folder's host, and its private key. Raises InputError."""
    options = tls(folder)
    return Path(options["listen_certificate"]), Path(options["listen_private_key"])


def access_control(folder: Path) -> dict[str, Any]:
    """Zenoh's `access_control`: listed hosts may listen to the fleet and write their own keys; other names have no
    rights.

    Raises InputError.
    """
    access = _access(folder)
    everything, written = [f"{KEYS}/**"], ["put", "delete", "reply", "liveliness_token", "declare_queryable"]
    heard = ["declare_subscriber", "declare_liveliness_subscriber", "liveliness_query", "query"]
    rules = [
        _rule("hear", "ingress", heard, everything),
        # If declarations may not go out nothing arrives, and no error tells of it.
        _rule("tell", "egress", [*written, *heard], everything),
        _rule("pass on", "ingress", written, everything),
        *(_rule(f"write {host}", "ingress", written, [keys_of(host)]) for host in access.hosts),
    ]
    subjects = [{"id": host, "cert_common_names": [host]} for host in access.hosts]
    policies = [
        {
            "subjects": [host],
            "rules": ["hear", "tell", "pass on" if host in access.passing_on else f"write {host}"],
        }
        for host in access.hosts
    ]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def passing_on(folder: Path) -> tuple[str, ...]:
    """The hosts that may pass on messages of others, by a host's folder. Raises InputError."""
    return _access(folder).passing_on


def _rule(name: str, flow: str, messages: list[str], keys: list[str]) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": keys}


def _access(folder: Path) -> _Access:
    path = folder / _ACCESS
    try:
        return msgspec.json.decode(path.read_bytes(), type=_Access)
    except (OSError, msgspec.MsgspecError) as error:
        mend = "copy the host's folder that `cfgplan certificates` has made"
        raise InputError.of(
            f"can't be read: {getattr(error, 'strerror', None) or error}", file=str(path), mend=mend
        ) from None


def _end_of(file: Path) -> datetime:
    """When a certificate ends. Raises InputError."""
    from cryptography import x509

    try:
        return x509.load_pem_x509_certificate(file.read_bytes()).not_valid_after_utc
    except (OSError, ValueError) as error:
        mend = "copy the host's folder that `cfgplan certificates` has made"
        message = f"this certificate can't be read: {getattr(error, 'strerror', None) or error}"
        raise InputError.of(message, file=str(file), mend=mend) from None


def _refuse_names(names: Iterable[str]) -> None:
    bad = [name for name in names if not _NAME.fullmatch(name)]
    if bad:
        mend = "letters, digits, dots, - and _, at most 63"
        raise InputError([Fault(f"{name!r} can't be the name of a host", mend=mend) for name in bad])


def _refuse_overwriting(folders: Iterable[Path]) -> None:
    mend = "name another folder, or remove this one first"
    there = [Fault("exists already, and is not overwritten", file=str(path), mend=mend) for path in folders
             if os.path.lexists(path)]  # fmt: skip
    if there:
        raise InputError(there)


def _authority(folder: Path) -> _Authority:
    """Read the folder's authority, or make one if there is none."""
    from cryptography import x509
    from cryptography.hazmat.primitives import serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    paths = folder / _AUTHORITY_CERTIFICATE, folder / _AUTHORITY_KEY
    if not any(path.exists() for path in paths):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        authority = _new_authority()
        _write(paths[0], authority.certificate.public_bytes(serialization.Encoding.PEM))
        _write(paths[1], _pem(authority.key))
        return authority
    try:
        key = serialization.load_pem_private_key(paths[1].read_bytes(), None)
        certificate = x509.load_pem_x509_certificate(paths[0].read_bytes())
    except (OSError, ValueError, TypeError) as error:
        raise InputError.of(f"the authority can't be read: {error}", file=str(folder), mend="name another") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
        raise InputError.of("the authority's key is not that of its certificate", file=str(folder), mend="name another")
    return _Authority(certificate, key)


def _new_authority() -> _Authority:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric import ec

    key = ec.generate_private_key(ec.SECP256R1())
    usage = x509.KeyUsage(
        digital_signature=False, content_commitment=False, key_encipherment=False, data_encipherment=False,
        key_agreement=False, key_cert_sign=True, crl_sign=True, encipher_only=False, decipher_only=False,
    )  # fmt: skip
    more = [
        (x509.BasicConstraints(ca=True, path_length=0), True),
        (usage, True),
        (x509.SubjectKeyIdentifier.from_public_key(key.public_key()), False),
    ]
    return _Authority(_certificate("cfgplan's authority", key, None, _AUTHORITY_DAYS, more), key)


def _make_host(folder: Path, authority: _Authority, names: Sequence[str], days: int) -> None:
    from cryptography import x509
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.hazmat.primitives.serialization import Encoding
    from cryptography.x509.oid import ExtendedKeyUsageOID

    key = ec.generate_private_key(ec.SECP256R1())
    more = [
        (x509.BasicConstraints(ca=False, path_length=None), True),
        (x509.ExtendedKeyUsage([ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]), False),
        (x509.SubjectAlternativeName(_alternatives(names)), False),
        (x509.AuthorityKeyIdentifier.from_issuer_public_key(authority.key.public_key()), False),
    ]
    folder.mkdir(mode=0o700)
    _write(folder / _AUTHORITY_CERTIFICATE, authority.certificate.public_bytes(Encoding.PEM))
    _write(folder / _CERTIFICATE, _certificate(names[0], key, authority, days, more).public_bytes(Encoding.PEM))
    _write(folder / _KEY, _pem(key))


def _certificate(
    name: str,
    key: ec.EllipticCurvePrivateKey,
    authority: _Authority | None,
    days: int,
    more: Iterable[tuple[x509.ExtensionType, bool]],
) -> x509.Certificate:
    """A certificate that an authority signs, or None: itself. `more` has extensions, and whether each is critical."""
    from cryptography import x509
    from cryptography.hazmat.primitives.hashes import SHA256

    own, now = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)]), datetime.now(UTC)
    builder = (
        x509.CertificateBuilder()
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _CLOCKS_DIFFER)
        .not_valid_after(now + timedelta(days=days))
        .subject_name(own)
        .issuer_name(own if authority is None else authority.certificate.subject)
        .public_key(key.public_key())
    )
    for extension, is_critical in more:
        builder = builder.add_extension(extension, critical=is_critical)
    return builder.sign(key if authority is None else authority.key, SHA256())


def _alternatives(names: Iterable[str]) -> list[x509.GeneralName]:
    from cryptography import x509

    return [
        x509.IPAddress(ip_address(name)) if _is_address(name) else x509.DNSName(name) for name in dict.fromkeys(names)
    ]


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    from cryptography.hazmat.primitives import serialization

    private = serialization.PrivateFormat.PKCS8
    return key.private_bytes(serialization.Encoding.PEM, private, serialization.NoEncryption())


def _write(path: Path, content: bytes) -> None:
    """Write a file that must not exist yet, and that only its owner can read."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)
