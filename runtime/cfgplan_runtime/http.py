"""Unit code for HTTP: a source that asks for a resource again and again.

`source: cfgplan_runtime.http:Poller`, with `run: {rate: 1}` for how often; the parameters are those of the class.
"""

from __future__ import annotations

import ssl
from base64 import b64encode
from collections.abc import Mapping
from http.client import HTTPException
from typing import Any, Final
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import HTTPSHandler, OpenerDirector, Request, build_opener

from cfgplan.errors import InputError
from cfgplan_runtime.outside.credentials import check_names, read_password
from cfgplan_runtime.outside.payload_forms import PayloadForm, PayloadReader
from cfgplan_runtime.outside.units import check_call, say, words_of

_TIMEOUT_S: Final = 5.0
_LOGIN: Final = ("username", "password_env", "password_file", "token_env", "token_file")
_LONGEST: Final = 1 << 26
"""Bytes of an answer; a longer one is an error."""


class Poller:
    """A source: asks for the resource at `url` (http or https) at the transformation's rate, and gives its value.

    `payload` is the form of answers (json, text, number or bytes). An element is the value of an answer, or of its
    `field`: a key of JSON, or a list of keys that lead further in. If the resource does not answer, or with an error,
    it gives no elements; this is reported once with the reason, and once when it answers again. A `username` needs a
    password in the environment variable `password_env` or in the file `password_file`; `token_env` and `token_file`
    name a bearer's token. `ca` is a file of TLS certificates, relative to the working folder. Raises InputError.
    """

    def __init__(
        self,
        url: str,
        payload: PayloadForm = "json",
        field: str | list[str | int] | None = None,
        ca: str | None = None,
        **login: Any,
    ) -> None:
        check_names("HTTP", _LOGIN, login)
        self._reader = PayloadReader(payload, field, say)
        # Not sent to the target of a redirection, which must not learn the password.
        self._request = Request(_checked(url))
        if (authorization := _authorization(**login)) is not None:
            self._request.add_unredirected_header("Authorization", authorization)
        self._url = url
        self._opener = _opener(ca)
        self._is_away = False

    @classmethod
    def check_params(cls, params: Mapping[str, Any]) -> None:
        """Raise InputError for params with which no unit can be constructed. Sends no request."""
        check_call(cls, "HTTP", _LOGIN, params)
        _checked(params["url"])

    def __call__(self) -> object:
        try:
            with self._opener.open(self._request, timeout=_TIMEOUT_S) as answer:
                payload: bytes = answer.read(_LONGEST + 1)
        except HTTPError as error:
            error.close()
            return self._away(f"answers {error.code} {error.reason}")
        except (OSError, HTTPException) as error:
            return self._away(f"does not answer ({words_of(getattr(error, 'reason', error))})")
        if len(payload) > _LONGEST:
            return self._away(f"answers more than {_LONGEST} bytes")
        if self._is_away:
            say(f"{self._url} answers again")
        self._is_away = False
        values = self._reader.values(self._url, payload)
        return values[0] if values else None

    def _away(self, what: str) -> object:
        """Tell once that the resource can't be had. Returns None: no element."""
        if not self._is_away:
            say(f"{self._url} {what}; it is tried again")
        self._is_away = True
        return None


def _authorization(
    username: str | None = None,
    password_env: str | None = None,
    password_file: str | None = None,
    token_env: str | None = None,
    token_file: str | None = None,
) -> str | None:
    """Return the Authorization header; None without a user name or token. Raises InputError."""
    if username is not None:
        word = f"{username}:{read_password(password_env, password_file) or ''}"
        return f"Basic {b64encode(word.encode()).decode()}"
    token = read_password(token_env, token_file)
    return None if token is None else f"Bearer {token}"


def _checked(url: str) -> str:
    """The URL of a resource. Raises InputError."""
    mend = "write http://HOST/PATH or https://HOST/PATH"
    try:
        address = urlsplit(url)
        is_right = address.scheme in ("http", "https") and bool(address.hostname) and address.port != 0
    except ValueError:
        is_right = False
    if not is_right:
        raise InputError.of(f"`{url}` is not the URL of a resource", mend=mend)
    if "@" in address.netloc:
        mend = "remove it, and write `username` with `password_env` or `password_file`"
        raise InputError.of("a URL can't hold the name and password", mend=mend)
    return url


def _opener(ca: str | None) -> OpenerDirector:
    """Raise InputError."""
    try:
        return build_opener(HTTPSHandler(context=ssl.create_default_context(cafile=ca)))
    except OSError as error:
        mend = "name a file in PEM"
        raise InputError.of(f"the authority of TLS can't be read: {error}", file=ca, mend=mend) from None
