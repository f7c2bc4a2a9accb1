# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Run the server until it is interrupted, or in a background thread."""
from __future__ import annotations

import asyncio
from contextlib import contextmanager
import socket
import threading
from typing import Iterator

from aiohttp import web

from .server import Studio

_SHUTDOWN_S = 2.0  # time for responses in progress


def serve(studio: Studio, sock: socket.socket) -> None:
    """
    Serve until interrupted or terminated.

    :param studio: the application.
    :param sock: bound socket, from :meth:`.guard.Guard.bind`.
    """
    web.run_app(studio.app(), sock=sock, print=None, access_log=None,
                shutdown_timeout=_SHUTDOWN_S)


@contextmanager
def served(studio: Studio, sock: socket.socket) -> Iterator[None]:
    """
    Serve in a thread as long as the context lasts.

    :param studio: the application.
    :param sock: bound socket, from :meth:`.guard.Guard.bind`.
    """
    loop = asyncio.new_event_loop()
    runner = web.AppRunner(studio.app(), access_log=None, shutdown_timeout=_SHUTDOWN_S)

    async def start() -> None:
        await runner.setup()
        await web.SockSite(runner, sock).start()

    def work() -> None:
        asyncio.set_event_loop(loop)
        loop.run_forever()
    thread = threading.Thread(target=work, name='studio', daemon=True)
    thread.start()
    try:
        asyncio.run_coroutine_threadsafe(start(), loop).result()
        yield
    finally:
        asyncio.run_coroutine_threadsafe(runner.cleanup(), loop).result()
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()
