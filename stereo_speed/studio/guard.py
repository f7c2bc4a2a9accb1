# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Access control: only a browser that was given the address printed in the terminal may connect.

- The address contains a secret token. The first visit turns it into a cookie that scripts cannot
  read and that other sites cannot send along.
- Requests must name the server by the address it was started with (not by a foreign name that
  resolves to this machine), and requests from a page must come from this server's page.
- Pages load scripts, styles and pictures from this server only, and run no inline scripts.
"""
from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from typing import Awaitable, Callable

from aiohttp import web

from ..core.errors import InputError

LOCALHOST = '127.0.0.1'
POLICY = '; '.join((
    "default-src 'none'", "script-src 'self'", "style-src 'self'", "img-src 'self' blob:",
    "connect-src 'self'", "base-uri 'none'", "form-action 'none'", "frame-ancestors 'none'"))
HEADERS = {
    'Content-Security-Policy': POLICY,
    'X-Content-Type-Options': 'nosniff',
    'Referrer-Policy': 'no-referrer',
    'Cross-Origin-Opener-Policy': 'same-origin',
    'Cross-Origin-Resource-Policy': 'same-origin',
    'Cache-Control': 'no-store',
}
DENIED = 'Open the address that the program has printed: it ends in a secret word.\n'
_SECRET_BYTES = 24
_MOST_SECRET = 200  # characters of a token that are compared

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class Guard:
    """
    The access rules of one server.

    :param address: IP address of this machine to listen on, not a wildcard.
    """

    def __init__(self, address: str = LOCALHOST) -> None:
        try:
            ip = ipaddress.ip_address(address)
        except ValueError:
            raise InputError('studio', '--address', repr(address),
                             'an IP address of this machine') from None
        if ip.is_unspecified:
            raise InputError('studio', '--address', address,
                             'one address of this machine, not all of them')
        self.address = address
        self._names = {f'[{ip}]' if ip.version == 6 else str(ip)}
        if ip.is_loopback:
            self._names.add('localhost')
        self.secret = secrets.token_urlsafe(_SECRET_BYTES)
        self.port = 0

    def bind(self, port: int) -> socket.socket:
        """
        Return a socket to listen on.

        :param port: port; 0 for any free one.
        :raises InputError: the port cannot be bound.
        """
        family = socket.AF_INET6 if ':' in self.address else socket.AF_INET
        sock = socket.socket(family, socket.SOCK_STREAM)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            sock.bind((self.address, port))
            sock.listen()  # clients may connect as soon as the URL is printed
        except OSError as error:
            sock.close()
            raise InputError('studio', f'port {port} of {self.address}',
                             (error.strerror or str(error)).lower(),
                             'a free port (--port 0 takes any)') from None
        self.port = int(sock.getsockname()[1])
        return sock

    @property
    def url(self) -> str:
        """Return the address to open."""
        host = f'[{self.address}]' if ':' in self.address else self.address
        return f'http://{host}:{self.port}/?token={self.secret}'

    @property
    def cookie(self) -> str:
        """Return the name of the cookie; it has the port, because ports share cookies."""
        return f'studio_{self.port}'

    def knows(self, secret: str) -> bool:
        """Return whether a token is the secret one."""
        return hmac.compare_digest(secret[:_MOST_SECRET].encode(), self.secret.encode())

    @property
    def _hosts(self) -> set[str]:
        return {f'{name}:{self.port}' for name in self._names}

    def refusal(self, request: web.Request) -> str:
        """Return why a request is refused; empty where it is allowed."""
        if request.headers.get('Host', '').lower() not in self._hosts:
            return 'This server answers to the address it was started with only.\n'
        origin = request.headers.get('Origin')
        if origin is not None and origin.lower() not in {f'http://{h}' for h in self._hosts}:
            return 'Requests from other sites are refused.\n'
        if request.headers.get('Sec-Fetch-Site', 'none') not in ('same-origin', 'none') \
                and not _arrives(request):
            return 'Requests from other sites are refused.\n'
        if not self.knows(request.cookies.get(self.cookie, '')) and not _arrives(request):
            return DENIED
        return ''

    @web.middleware
    async def middleware(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse forbidden requests, and add the security headers to every response."""
        reason = self.refusal(request)
        if reason:
            return web.Response(status=403, text=reason, headers=HEADERS)
        if _arrives(request):
            return self._welcome(request)
        try:
            response = await handler(request)
        except web.HTTPException as error:
            error.headers.update(HEADERS)
            raise
        if not response.prepared:
            response.headers.update(HEADERS)
        return response

    def _welcome(self, request: web.Request) -> web.Response:
        """Turn the secret token of the address into a cookie, and redirect to the bare address."""
        if not self.knows(request.query['token']):
            return web.Response(status=403, text=DENIED, headers=HEADERS)
        response = web.Response(status=303, headers={**HEADERS, 'Location': '/'})
        response.set_cookie(self.cookie, self.secret, httponly=True, samesite='Strict', path='/')
        return response


def _arrives(request: web.Request) -> bool:
    """Return whether this is a first visit, with the secret token in the address."""
    return request.method == 'GET' and request.path == '/' and 'token' in request.query
