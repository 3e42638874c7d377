"""The page's web server: on loopback by default, else with TLS. Changing the run needs the page's token."""

from __future__ import annotations

import asyncio
import hmac
import json
import secrets
import socket
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Route

from cfgplan.errors import InputError
from cfgplan_runtime.errors import ControlError
from cfgplan_runtime.fleet.certificates import shown
from cfgplan_runtime.operating.control_client import Control
from cfgplan_runtime.operating.declaration import declaration
from cfgplan_runtime.operating.protocol import RefusedError
from cfgplan_runtime.page.peeks import Subscribe
from cfgplan_runtime.page.watched import Watched
from cfgplan_runtime.streams.subscription import subscribe

THIS_COMPUTER = "127.0.0.1"
METHODS = (
    "add",
    "kill",
    "restart",
    "lose_host",
    "regain_host",
    "remove_target",
    "remove_transformation",
    "restore",
    "review",
    "stop",
    "what_if",
    "why",
    "withdraw",
)
"""The methods of the control socket that the page may call."""
_NEEDS_TOKEN = "the page needs the token in its address: open the whole address that was printed"
_LONGEST_NUMBER = 15
_ALIVE_S = 5.0
_LARGEST_REQUEST = 1_000_000
_FILES = Path(__file__).parent
_KINDS = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


def is_loopback(address: str) -> bool:
    """Whether only this computer can reach an address."""
    return address in (THIS_COMPUTER, "localhost", "::1")


class PageServer:
    """Serves the page of a run from a thread of its own until it is closed; a context manager.

    On a loopback address viewing needs no token; on other addresses it does. Changing the run always needs the token.
    An address other than loopback needs the folder of a host's `certificates`. The page adds transformations with a
    `source`, which is code, only if it `allows_code`. `subscribe` reaches topics, by default those of this computer.
    Port 0 takes any free port. Raises InputError if the address can't be used, ControlError if no run is live.
    """

    def __init__(
        self,
        reach: Callable[[], Control],
        address: str = THIS_COMPUTER,
        port: int = 0,
        *,
        certificates: Path | None = None,
        allows_code: bool = False,
        subscribe: Subscribe = subscribe,
    ) -> None:
        self._allows_code = allows_code
        self._token = secrets.token_urlsafe(16)
        self._is_open = is_loopback(address)
        if not self._is_open and certificates is None:
            mend = "name this computer's folder of `cfgplan certificates` by --certificates, or leave --address out"
            raise InputError.of(f"--address {address}: others would read the page's token on its way", mend=mend)
        identity = None if certificates is None else shown(certificates)
        family = socket.AF_INET6 if ":" in address else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._socket.bind((address, port))
            self._socket.listen()  # at once: two may be bound to an address while neither listens
        except (OSError, OverflowError) as error:
            self._socket.close()
            why = getattr(error, "strerror", None) or error
            mend = "name another port; 0 takes any that is free"
            raise InputError.of(f"{address}:{port} can't be served: {why}", mend=mend) from None
        self.watched = Watched(reach, subscribe)
        try:
            self.watched.start()
        except BaseException:
            self._socket.close()
            raise
        name = f"[{address}]" if ":" in address else address
        self._origin = f"http{'s' if identity else ''}://{name}:{self._socket.getsockname()[1]}"
        hosts = [name, "localhost"] if self._is_open else ["*"]
        app = Starlette(
            routes=[
                Route("/", _file(_FILES / "page.html")),
                *(Route(f"/{path.name}", _file(path)) for path in sorted(_FILES.iterdir()) if path.suffix in _KINDS),
                Route("/messages", self._messages),
                Route("/moment", self._moment),
                Route("/peek", self._peek, methods=["POST"]),
                Route("/do", self._do, methods=["POST"]),
            ],
            middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=hosts)],
        )
        certificate, key = identity or (None, None)
        config = uvicorn.Config(
            app,
            log_level="warning",
            lifespan="off",
            timeout_graceful_shutdown=1,
            ssl_certfile=certificate,
            ssl_keyfile=key,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, args=([self._socket],), daemon=True)

    @property
    def url(self) -> str:
        """The page's address, with the token that its buttons need."""
        return f"{self._origin}/#{self._token}"

    def __enter__(self) -> PageServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.should_exit = True
        self._thread.join(timeout=5)
        self._socket.close()
        self.watched.close()

    def _may(self, token: str | None) -> bool:
        return token is not None and hmac.compare_digest(token.encode(), self._token.encode())

    def _may_look(self, request: Request) -> bool:
        return self._is_open or self._may(request.query_params.get("token"))

    async def _moment(self, request: Request) -> Response:
        """The state right after a review: `?review=NUMBER`."""
        if not self._may_look(request):
            return JSONResponse({"message": _NEEDS_TOKEN}, 403, headers=_HEADERS)
        asked = request.query_params.get("review", "")
        if not asked.isdecimal() or len(asked) > _LONGEST_NUMBER:
            return JSONResponse({"message": "this is not a request"}, 400, headers=_HEADERS)
        try:
            return JSONResponse(await asyncio.to_thread(self.watched.moment, int(asked)), headers=_HEADERS)
        except (RefusedError, ControlError) as error:
            return JSONResponse({"refused": str(error)}, headers=_HEADERS)

    async def _messages(self, request: Request) -> Response:
        if not self._may_look(request):
            return JSONResponse({"message": _NEEDS_TOKEN}, 403, headers=_HEADERS)
        return StreamingResponse(self._told(), media_type="text/event-stream", headers=_HEADERS)

    async def _told(self) -> AsyncIterator[str]:
        system = self.watched.system
        with self.watched.viewer(asyncio.get_running_loop()) as viewer:
            run = {"run": system.run, "environment": Path(system.environment).name, "name": system.name}
            yield _event("run", json.dumps({**run, "viewer": viewer.name}))
            while not self._server.should_exit:
                with suppress(TimeoutError):
                    kind, data = await asyncio.wait_for(viewer.messages.get(), _ALIVE_S)
                    yield _event(kind, data)
                    if kind == "ended":
                        return

    async def _peek(self, request: Request) -> Response:
        """Let a viewer peek into a stream: `{"viewer": ..., "stream": ...}`. The viewer's name is known to it alone."""
        asked = await _body(request)
        if asked is None or not isinstance(asked.get("stream"), str | None):
            return JSONResponse({"message": "this is not a request"}, 400, headers=_HEADERS)
        viewer = str(asked.get("viewer", ""))
        if not await asyncio.to_thread(self.watched.peek, viewer, asked["stream"]):
            return JSONResponse({"message": "no page of this name looks"}, 403, headers=_HEADERS)
        return JSONResponse({}, headers=_HEADERS)

    async def _do(self, request: Request) -> Response:
        """Change the run: `{"method": ..., "params": {...}}`, accepted only from this page and with its token."""
        origin = request.headers.get("origin")
        if not self._may(request.headers.get("x-token")) or (self._is_open and origin != self._origin):
            return JSONResponse({"message": "only the page with its token may do this"}, 403, headers=_HEADERS)
        asked = await _body(request)
        if asked is None or "method" not in asked or not isinstance(params := asked.get("params", {}), dict):
            return JSONResponse({"message": "this is not a request"}, 400, headers=_HEADERS)
        method = asked["method"]
        if method not in METHODS:
            return JSONResponse({"message": f"the page does not do {method}"}, 400, headers=_HEADERS)
        added = params.get("params") if method == "what_if" else params
        text = added.get("text") if isinstance(added, dict) else None
        if not self._allows_code and _names_code(text):
            refused = "a `source` is code, which this page does not add: use `cfgplan ctl add`, or --allow-code"
            return JSONResponse({"refused": refused}, headers=_HEADERS)
        try:
            return JSONResponse(await asyncio.to_thread(self.watched.call, method, params), headers=_HEADERS)
        except RefusedError as error:
            refused = "; ".join(map(str, error.faults)) or str(error)
        except ControlError as error:
            refused = str(error)
        # A refusal of the run is an answer, and no error of the page, which browsers would report.
        return JSONResponse({"refused": refused}, headers=_HEADERS)


def _file(path: Path) -> Callable[[Request], Response]:
    def get(_: Request) -> Response:
        return FileResponse(path, media_type=_KINDS[path.suffix], headers=_HEADERS)

    return get


async def _body(request: Request) -> dict[str, Any] | None:
    """The JSON object of a request; None if it has none, or too large a one."""
    body = await request.body()
    try:
        asked = json.loads(body[:_LARGEST_REQUEST])
    except ValueError:
        return None
    return asked if isinstance(asked, dict) else None


def _names_code(text: object) -> bool:
    """Whether an addition has a transformation with unit code. The run refuses an unreadable addition."""
    try:
        added = declaration("page", text).change.document if isinstance(text, str) else {}
    except InputError:
        return False
    written = added.get("transformations")
    return isinstance(written, list) and any(isinstance(one, dict) and "source" in one for one in written)


def _event(kind: str, data: str) -> str:
    return f"event: {kind}\ndata: {data}\n\n"
