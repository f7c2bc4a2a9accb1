# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
The server: files of the page, the draft and its figures, runs, and live data.

It serves only what was opened at its start, by number or by a fixed list of names: no part of a
URL is ever used as a path. All texts that a page shows are sent as JSON.
"""
from __future__ import annotations

import asyncio
from functools import partial
import json
import logging
from pathlib import Path
from typing import Any, Awaitable, Callable, Mapping, Optional, Sequence

from aiohttp import web, WSMsgType
import numpy as np

from .draft import Draft, VIEWS
from .edits import Step, WHERE
from .evidence import EvidenceRun
from .guard import Guard
from .live import LiveState
from .measure import measure
from .runs import Row, Run
from .scene import BAND_SIGMAS, epipolar_curve, on_plane, PICK_STD_PX, Scene
from .workspace import Workspace
from ..core.errors import InputError, StereoSpeedError

WEB = Path(__file__).resolve().parent / 'web'
TYPES = {'.html': 'text/html', '.css': 'text/css', '.js': 'text/javascript',
         '.svg': 'image/svg+xml'}
MOST_REQUEST = 2**20  # largest request, bytes
HEARTBEAT_S = 20.0
_log = logging.getLogger(__name__)
_LIVE_PERIOD_S = 0.25
_HELD_RUNS = 20  # number of kept runs that were measured on the page

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


def page_files() -> dict[str, Path]:
    """Return the files of the page by name."""
    return {path.name: path for path in sorted(WEB.iterdir()) if path.suffix in TYPES}


class Studio:
    """
    The web application, with its open data and connected pages.

    :param guard: the access rules.
    :param workspace: the draft; None where only runs or live readings are shown.
    :param runs: runs to review.
    :param live: live data; None where there are none.
    """

    def __init__(self, guard: Guard, workspace: Optional[Workspace] = None,
                 runs: Optional[Sequence[Run]] = None, live: Optional[LiveState] = None
                 ) -> None:
        self.guard, self.workspace, self.live = guard, workspace, live
        self.runs: dict[int, Run] = dict(enumerate(runs or []))  # numbers are not reused
        self._next_run = len(self.runs)
        self.busy, self._measured = '', 0
        self._files = page_files()
        self._sockets: set[web.WebSocketResponse] = set()
        self._judging: Optional[asyncio.Task[None]] = None
        self._tasks: set[asyncio.Task[Any]] = set()

    @property
    def scene(self) -> Optional[Scene]:
        """Return the open bag; None where there is none."""
        return None if self.workspace is None else self.workspace.scene

    def app(self) -> web.Application:
        """Return the application."""
        app = web.Application(middlewares=[self.guard.middleware, _errors],
                              client_max_size=MOST_REQUEST)
        app.router.add_get('/', partial(self._file, name='index.html'))
        app.router.add_get('/web/{name}', self._file)
        app.router.add_get('/api/socket', self._socket)
        app.router.add_get('/api/state', self._state)
        app.router.add_post('/api/step', self._step)
        app.router.add_post('/api/save', self._save)
        app.router.add_post('/api/refine', self._refine)
        app.router.add_post('/api/measure', self._measure)
        app.router.add_post('/api/epipolar', self._epipolar)
        app.router.add_get('/api/background/{view}', self._background)
        app.router.add_get('/api/frame/{index}/{view}', self._frame)
        app.router.add_get('/api/runs/{run}', self._run)
        app.router.add_post('/api/runs/{run}/table', self._run_table)
        app.router.add_get('/api/runs/{run}/pass/{key}', self._pass)
        app.router.add_get('/api/runs/{run}/plot/{name}', self._plot)
        app.router.add_get('/api/runs/{run}/verified', self._verified)
        app.router.add_get('/api/runs/{run}/pass/{key}/file/{index}', self._record_file)
        app.router.add_get('/api/live', self._live)
        app.router.add_get('/api/live/overlay/{view}', self._live_overlay)
        app.on_startup.append(self._start)
        app.on_shutdown.append(self._stop)
        return app

    async def _start(self, _: web.Application) -> None:
        if self.live is not None:
            self._keep(asyncio.create_task(self._tell_live()))

    async def _stop(self, _: web.Application) -> None:
        for task in list(self._tasks):
            task.cancel()
        for socket in list(self._sockets):
            await socket.close()

    def _keep(self, task: asyncio.Task[Any]) -> None:
        """Keep a reference to a task until it is done; the event loop holds only a weak one."""
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # -- the page -------------------------------------------------------------------------------

    async def _file(self, request: web.Request, name: str = '') -> web.StreamResponse:
        path = self._files.get(name or request.match_info['name'])
        if path is None:
            raise web.HTTPNotFound(text='no such file\n')
        return web.Response(body=path.read_bytes(), content_type=TYPES[path.suffix],
                            charset='utf-8')

    async def _whole_state(self) -> dict[str, Any]:
        """Return the state that a page starts with, current when this returns."""
        runs = await self._overviews()
        out: dict[str, Any] = {'kind': 'state', 'busy': self.busy, 'has_live': bool(self.live),
                               'runs': runs,
                               'workspace': None, 'figures': None, 'scene': None}
        if self.workspace is not None:
            out['workspace'] = self.workspace.state()
            out['figures'] = self.workspace.figures.data
        if self.scene is not None:
            rig = self.scene.rig
            out['scene'] = {
                'bag': self.scene.path.resolve().name, 'pairs': self.scene.pair_count,
                'sizes': {view: [camera.width_px, camera.height_px]
                          for view, camera in zip(VIEWS, (rig.left, rig.right))},
                'spread': len(self.scene.spread)}
        return out

    async def _overviews(self) -> list[dict[str, Any]]:
        """Return an entry for each run, read in a thread."""
        asked: dict[int, Run] = {}
        found: list[dict[str, Any]] = []
        while asked != self.runs:  # again if a run was added meanwhile
            asked = dict(self.runs)
            found = await asyncio.to_thread(_overviews, asked)
        return found

    async def _state(self, request: web.Request) -> web.StreamResponse:
        return web.json_response(await self._whole_state())

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        socket = web.WebSocketResponse(heartbeat=HEARTBEAT_S, max_msg_size=MOST_REQUEST)
        await socket.prepare(request)
        state = await self._whole_state()
        self._sockets.add(socket)  # from now on changes are sent, after the state
        try:
            await socket.send_json(state)
            if self.live is not None:
                await socket.send_json({'kind': 'live', **self.live.snapshot()})
            async for message in socket:
                if message.type is WSMsgType.ERROR:
                    break
        finally:
            self._sockets.discard(socket)
        return socket

    async def _tell(self, message: dict[str, Any]) -> None:
        """Send a message to all pages; closed ones are removed."""
        text = json.dumps(message)
        for socket in list(self._sockets):
            try:
                await socket.send_str(text)
            except (ConnectionError, RuntimeError):
                self._sockets.discard(socket)

    async def _tell_live(self) -> None:
        """Send the live data a few times per second."""
        live, sent = self.live, -1
        while live is not None:
            await asyncio.sleep(_LIVE_PERIOD_S)
            now = live.snapshot()
            if self._sockets and (now['number'] != sent or now['stale']):
                sent = now['number']
                await self._tell({'kind': 'live', **now})

    # -- the draft ------------------------------------------------------------------------------

    def _drawing(self) -> Workspace:
        if self.workspace is None:
            raise InputError(WHERE, 'bag', 'none', 'a bag to draw on')
        return self.workspace

    def _filmed(self) -> Scene:
        if self.scene is None:
            raise web.HTTPNotFound(text='no bag is open\n')
        return self.scene

    async def _step(self, request: web.Request) -> web.StreamResponse:
        space, data = self._drawing(), await _body(request)
        if space.take(data):
            await self._changed()
        return web.json_response({'version': space.version})

    async def _changed(self) -> None:
        """Send the draft to all pages, and start its assessment."""
        space = self._drawing()
        await self._tell({'kind': 'draft', 'workspace': space.state()})
        if self._judging is None or self._judging.done():
            self._judging = asyncio.create_task(self._judge())
            self._keep(self._judging)

    async def _judge(self) -> None:
        """Assess the draft, again if it changed meanwhile."""
        space, judged = self._drawing(), -1
        while judged != space.version:
            judged, draft, refined = space.version, space.draft, space.refined
            figures = await asyncio.to_thread(space.judged, draft, refined)
            space.figures = figures
            await self._tell({'kind': 'figures', 'version': judged, 'figures': figures.data})

    async def _save(self, request: web.Request) -> web.StreamResponse:
        space = self._drawing()
        step = Step(await _body(request), ('what', 'overwrite'))
        saves = {'site': space.save, 'init': space.save_init, 'truth': space.save_truth}
        path = saves[step.choice('what', saves)](step.flag('overwrite'))
        await self._tell({'kind': 'draft', 'workspace': space.state()})
        return web.json_response({'saved': path.name})

    async def _refine(self, request: web.Request) -> web.StreamResponse:
        space = self._drawing()
        draft = space.draft
        refined = await self._alone('finding the lines in the images',
                                    lambda: space.refine(draft))
        space.accept(draft, refined)
        await self._changed()
        return web.json_response({'kept_clicks': refined.kept_clicks})

    async def _measure(self, request: web.Request) -> web.StreamResponse:
        space, scene = self._drawing(), self._filmed()
        site, draft = space.site(space.draft), space.draft
        run = await self._alone('measuring the bag', lambda: measure(
            scene, site, self._free_name(draft), space.settings), scene)
        number = self._hold(run)
        await self._tell({'kind': 'runs', 'runs': await self._overviews()})
        return web.json_response({'run': number})

    def _hold(self, run: Run) -> int:
        """Add a measured run, and remove the oldest ones beyond the limit."""
        measured = [n for n, other in self.runs.items() if other.kind == run.kind]
        for number in measured[:len(measured) + 1 - _HELD_RUNS]:
            del self.runs[number]
        number, self._next_run = self._next_run, self._next_run + 1
        self.runs[number] = run
        self._measured += 1
        return number

    def _free_name(self, draft: Draft) -> str:
        """Return a name for a run with a draft."""
        return f'{draft.name}, measured here ({self._measured + 1})'

    async def _alone(self, what: str, work: Callable[[], Any], scene: Optional[Scene] = None
                     ) -> Any:
        """Run slow work, one at a time, and notify all pages."""
        if self.busy:
            raise InputError(WHERE, 'server', self.busy, 'a moment of patience')
        self.busy = what
        await self._tell({'kind': 'busy', 'busy': what})
        try:
            loop = asyncio.get_running_loop()
            return await loop.run_in_executor(None if scene is None else scene.thread, work)
        finally:
            self.busy = ''
            await self._tell({'kind': 'busy', 'busy': ''})

    async def _epipolar(self, request: web.Request) -> web.StreamResponse:
        space, scene = self._drawing(), self._filmed()
        step = Step(await _body(request), ('view', 'at'))
        view, at = step.choice('view', VIEWS), step.pixel()
        rig, plane = space.draft.rig_now(scene.rig), space.figures.plane
        place = None if plane is None else on_plane(rig, plane, view, at)
        return web.json_response({
            'curve': epipolar_curve(rig, view, at).round(2).tolist(),
            'half_width_px': BAND_SIGMAS * np.sqrt(2.0) * PICK_STD_PX,
            'on_road': None if place is None else place.round(2).tolist()})

    # -- images ---------------------------------------------------------------------------------

    async def _background(self, request: web.Request) -> web.StreamResponse:
        scene, view = self._filmed(), _view(request)
        return _png(await asyncio.to_thread(scene.background_png, view))

    async def _frame(self, request: web.Request) -> web.StreamResponse:
        scene, view, index = self._filmed(), _view(request), _number(request, 'index')
        return _png(await asyncio.get_running_loop().run_in_executor(
            scene.thread, scene.frame_png, index, view))

    # -- review ---------------------------------------------------------------------------------

    def _asked_run(self, request: web.Request) -> Run:
        run = self.runs.get(_number(request, 'run'))
        if run is None:
            raise web.HTTPNotFound(text='no such run\n')
        return run

    async def _run(self, request: web.Request) -> web.StreamResponse:
        run = self._asked_run(request)

        def read() -> dict[str, Any]:
            return {**run.overview(), 'rows': run.rows(), 'plots': run.plots}
        return web.json_response({**await asyncio.to_thread(read),
                                  'frames': await self._has_frames(run)})

    async def _has_frames(self, run: Run) -> bool:
        """Return whether the open bag is the one that was measured."""
        if self.scene is None or not run.bag_hash:
            return False
        loop = asyncio.get_running_loop()
        found = await loop.run_in_executor(self.scene.thread, self.scene.content_hash)
        return found == run.bag_hash

    async def _run_table(self, request: web.Request) -> web.StreamResponse:
        run, step = self._asked_run(request), Step(await _body(request), ('keys',))
        keys = [key for key in step.listed('keys') if type(key) is int and key >= 0]
        if len(keys) < len(step.listed('keys')):
            raise step.error('keys', 'another thing', 'whole numbers')
        text = await asyncio.to_thread(run.table, keys)
        return web.Response(text=text, content_type='text/csv',
                            headers={'Content-Disposition': 'attachment; filename="passes.csv"'})

    async def _pass(self, request: web.Request) -> web.StreamResponse:
        run, key = self._asked_run(request), _number(request, 'key')
        found = await asyncio.to_thread(run.opened, key)
        if found is None:
            raise web.HTTPNotFound(text='no such pass\n')
        out = {'rows': found.rows, 'more': found.more,
               'frames': await self._frames(run, found.rows)}
        if isinstance(run, EvidenceRun):
            out['files'] = await asyncio.to_thread(run.files, key)
        return web.json_response(out)

    async def _frames(self, run: Run, rows: Sequence[Row]) -> list[dict[str, Any]]:
        """Return the pair of each row with all its vehicles; empty where its bag is not open."""
        if self.scene is None or not await self._has_frames(run):
            return []
        rig, out = self.scene.rig, []
        for row in rows:
            stamp = row['stamp_ns']
            assert isinstance(stamp, int)  # noqa: S101 (for the types)
            out.append({'index': self.scene.index_of(stamp), 'vehicles': [
                _in_views(other, rig) for other in run.at(stamp)]})
        return out

    def _asked_evidence(self, request: web.Request) -> EvidenceRun:
        run = self._asked_run(request)
        if not isinstance(run, EvidenceRun):
            raise web.HTTPNotFound(text='no records\n')
        return run

    async def _verified(self, request: web.Request) -> web.StreamResponse:
        run = self._asked_evidence(request)
        return web.json_response(await asyncio.to_thread(run.verified))

    async def _record_file(self, request: web.Request) -> web.StreamResponse:
        run = self._asked_evidence(request)
        key, index = _number(request, 'key'), _number(request, 'index')
        found = await asyncio.to_thread(run.file, key, index)
        if found is None:
            raise web.HTTPNotFound(text='no such file\n')
        headers = {} if found.shown else {
            'Content-Disposition': f'attachment; filename="record_{key}_{index}"'}
        headers['Content-Type'] = found.media_type
        return web.FileResponse(found.path, headers=headers)

    async def _plot(self, request: web.Request) -> web.StreamResponse:
        path = self._asked_run(request).plot(request.match_info['name'])
        if path is None:
            raise web.HTTPNotFound(text='no such plot\n')
        return _png(await asyncio.to_thread(path.read_bytes))

    async def _live(self, request: web.Request) -> web.StreamResponse:
        if self.live is None:
            raise web.HTTPNotFound(text='nothing is live\n')
        return web.json_response(self.live.snapshot())

    async def _live_overlay(self, request: web.Request) -> web.StreamResponse:
        image = None if self.live is None else self.live.overlay(_view(request))
        if image is None:
            raise web.HTTPNotFound(text='no image yet\n')
        return web.Response(body=image, content_type='image/jpeg')


def _overviews(runs: Mapping[int, Run]) -> list[dict[str, Any]]:
    """Return an entry for each readable run."""
    found = []
    for number, run in runs.items():
        try:
            found.append({'number': number, **run.overview()})
        except (StereoSpeedError, OSError):  # removed since; the others are shown
            _log.warning('%s cannot be read now', run.name, exc_info=True)
    return found


def _in_views(row: dict[str, Any], rig: Any) -> dict[str, Any]:
    """Return a vehicle's row with the position and scale of its front in both views."""
    place = np.array([row['x_m'], row['y_m'], row['z_m']], dtype=np.float64)
    left, right, _, _ = rig.project(place)
    return {**row, 'views': {
        view: {'u': float(uv[0]), 'v': float(uv[1]),
               'px_per_m': float(camera.K[0, 0] / place[2])}
        for view, uv, camera in zip(VIEWS, (left, right), (rig.left, rig.right))
        if np.isfinite(uv).all() and place[2] > 0}}


def _view(request: web.Request) -> str:
    view = request.match_info['view']
    if view not in VIEWS:
        raise web.HTTPNotFound(text='no such view\n')
    return view


def _number(request: web.Request, key: str) -> int:
    text = request.match_info[key]
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise web.HTTPNotFound(text=f'no such {key}\n')
    return int(text)


def _png(data: bytes) -> web.Response:
    return web.Response(body=data, content_type='image/png')


async def _body(request: web.Request) -> dict[str, Any]:
    """Return the JSON object of a request."""
    if request.content_type != 'application/json':
        raise web.HTTPUnsupportedMediaType(text='JSON is wanted\n')
    try:
        data = json.loads(await request.text(), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise InputError(WHERE, 'request', str(error)[:80], 'JSON') from None
    if not isinstance(data, dict):
        raise InputError(WHERE, 'request', type(data).__name__, 'a JSON object')
    return data


def _refuse_constant(name: str) -> None:
    raise ValueError(f'{name} is no number')


@web.middleware
async def _errors(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Answer errors that a user can cause with one clear line."""
    try:
        return await handler(request)
    except StereoSpeedError as error:
        text = f'{error.what}: found {error.found}, wanted {error.wanted}' \
            if isinstance(error, InputError) else str(error)
        return web.json_response({'error': ' '.join(text.split())}, status=400)
