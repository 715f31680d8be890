"""The explorer's page on the loopback address: whoever asks must have the token, and gets what a `Session` answers.

What is refused, and why:

- another Host than our own: a site's name that was made to point to 127.0.0.1 (DNS rebinding);
- another Origin than our own, or no JSON: a page of another site that asks in the user's name;
- no token, or a wrong one: another user or program of this machine;
- a long or malformed message: what our page does not send.

No file is read for a request: the page's files are read once, and the log and the map were before.
"""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import socket
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from importlib import resources
from typing import TYPE_CHECKING, Any

from beamfield.errors import BeamfieldError, needs
from beamfield.explorer.requests import LARGEST_MESSAGE, SLOW

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

    from beamfield.explorer.session import Session

ADDRESS = "127.0.0.1"
# Of the component, each after those that it imports.
MODULES = (
    "words.js", "pictures.js", "elements.js", "latest.js", "plots.js", "map_view.js", "comparison.js", "panels.js",
    "explorer.js",
)  # fmt: skip
PAGE_FILES = {
    "index.html": "text/html; charset=utf-8",
    "explorer.css": "text/css; charset=utf-8",
    **dict.fromkeys(("page.js", *MODULES), "text/javascript; charset=utf-8"),
}
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
# Niceness of the thread that takes long.
GIVES_WAY = 10
TOKEN_HEADER = "X-Beamfield-Token"


def new_token() -> str:
    """Return a token that nobody can guess."""
    return secrets.token_urlsafe(24)


def page_file(name: str) -> bytes:
    """Return one of the page's files."""
    return resources.files("beamfield.explorer").joinpath("page", name).read_bytes()


def explorer_app(session: Session, token: str, port: int) -> Starlette:
    """Return the application that serves a session to whoever has the token.

    The port is that of the Host and the Origin that are ours. MissingDependencyError if Starlette is not installed.
    """
    with needs("starlette", "explore", "the explorer"):
        from starlette.applications import Starlette
        from starlette.responses import PlainTextResponse, Response
        from starlette.routing import Route

    files = {name: page_file(name) for name in PAGE_FILES}
    hosts = {f"{ADDRESS}:{port}", f"localhost:{port}"}
    # What takes long must not keep the answers waiting that a drag needs; within either there is one at a time.
    quick, slow = ThreadPoolExecutor(1), ThreadPoolExecutor(1, initializer=_give_way)

    def refused(request: Request) -> Response | None:
        if request.headers.get("host") not in hosts:
            return PlainTextResponse("another host was asked for\n", 403, HEADERS)
        origin = request.headers.get("origin")
        if origin is not None and origin not in {f"http://{host}" for host in hosts}:
            return PlainTextResponse("a page of another site asked\n", 403, HEADERS)
        return None

    def is_token(word: str | None) -> bool:
        return word is not None and secrets.compare_digest(word.encode(), token.encode())

    async def page(request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        if (answer := refused(request)) is not None:
            return answer
        if name == "index.html" and not is_token(request.query_params.get("token")):
            text = "The token is missing or wrong: open the address that beamfield explore printed.\n"
            return PlainTextResponse(text, 403, HEADERS)
        if name not in files:
            return PlainTextResponse("there is no such page\n", 404, HEADERS)
        return Response(files[name], headers={**HEADERS, "Content-Type": PAGE_FILES[name]})

    async def ask(request: Request) -> Response:
        if (answer := refused(request)) is not None:
            return answer
        if not is_token(request.headers.get(TOKEN_HEADER)):
            return _error("the token is missing or wrong", 403)
        if request.headers.get("content-type", "").split(";")[0].strip() != "application/json":
            return _error("expected JSON", 415)
        body = bytearray()
        async for chunk in request.stream():
            body += chunk
            if len(body) > LARGEST_MESSAGE:
                return _error(f"expected at most {LARGEST_MESSAGE} bytes", 413)
        try:
            message = json.loads(body)
        except (ValueError, RecursionError):
            return _error("expected JSON", 400)

        thread = slow if isinstance(message, dict) and message.get("name") in SLOW else quick
        try:
            content = await asyncio.get_running_loop().run_in_executor(thread, lambda: as_json(session.answer(message)))
        except BeamfieldError as error:
            return _error(str(error), 400)
        return Response(content, headers={**HEADERS, "Content-Type": "application/json"})

    app = Starlette(routes=[Route("/", page), Route("/ask", ask, methods=["POST"]), Route("/{name}", page)])
    app.router.redirect_slashes = False
    return app


def _give_way() -> None:
    """Let this thread wait for others, the browser's too, where the system ranks threads."""
    if sys.platform == "linux":
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), GIVES_WAY)


def as_json(answer: dict[str, Any]) -> bytes:
    """Return an answer as JSON; arrays as lists. A number that is not finite is an error, not ``NaN``."""
    return json.dumps(answer, allow_nan=False, default=_plain, separators=(",", ":")).encode()


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"cannot be sent: {type(value).__name__}")


def _error(text: str, status: int) -> Response:
    from starlette.responses import JSONResponse

    return JSONResponse({"error": text}, status, HEADERS)


def listening_socket(port: int) -> socket.socket:
    """Return a socket that listens on the loopback address alone; port 0 is any that is free."""
    # asyncio sends small answers at once (TCP_NODELAY) only where the protocol is named; they waited 40 ms otherwise.
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((ADDRESS, port))
        listening.listen()
    except OSError:
        listening.close()
        raise
    return listening


def page_address(port: int, token: str) -> str:
    """Return what to open in a browser."""
    return f"http://{ADDRESS}:{port}/?token={token}"
