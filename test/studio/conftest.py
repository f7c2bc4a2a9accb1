# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Shared fixtures of the page's tests: the opened sample, a running server, a plain client."""
from __future__ import annotations

from contextlib import contextmanager
import http.client
import json
from pathlib import Path
import sys
from typing import Any, Iterator, Optional

import numpy as np
import pytest
from stereo_speed.cli.main import main
from stereo_speed.core.passes import PassResult, Verdict
from stereo_speed.core.records import TrackState, TrackUpdate
from stereo_speed.io.results import write_run
from stereo_speed.studio.guard import Guard
from stereo_speed.studio.scene import Scene
from stereo_speed.studio.serve import served
from stereo_speed.studio.server import Studio
from stereo_speed.studio.workspace import Workspace

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / 'tools'))


class Client:
    """A plain client with or without the cookie."""

    def __init__(self, guard: Guard, known: bool = True) -> None:
        self.guard = guard
        self.headers = {'Cookie': f'{guard.cookie}={guard.secret}'} if known else {}

    def ask(self, method: str, path: str, body: Optional[bytes] = None,
            **headers: str) -> tuple[int, dict[str, str], bytes]:
        """Send a request and return status, headers and body."""
        connection = http.client.HTTPConnection('127.0.0.1', self.guard.port, timeout=30)
        more = {name.replace('_', '-'): value for name, value in headers.items()}
        connection.putrequest(method, path, skip_host='Host' in more)
        for name, value in {**self.headers, **more}.items():
            connection.putheader(name, value)
        if body is not None:
            connection.putheader('Content-Length', str(len(body)))
        connection.endheaders(body)
        answer = connection.getresponse()
        data = answer.read()
        connection.close()
        return answer.status, dict(answer.getheaders()), data

    def get(self, path: str) -> Any:
        """Return the JSON of an address."""
        status, _, data = self.ask('GET', path)
        assert status == 200, (path, status, data)
        return json.loads(data)

    def post(self, path: str, body: Any, status: int = 200) -> Any:
        """Post JSON and return JSON."""
        found, _, data = self.ask('POST', path, json.dumps(body).encode(),
                                  Content_Type='application/json')
        assert found == status, (path, found, data)
        return json.loads(data)

    def step(self, name: str, /, status: int = 200, identity: str = '', **fields: Any) -> Any:
        """Take a step."""
        self.count = getattr(self, 'count', 0) + 1
        return self.post('/api/step', {'id': identity or f'{id(self)}-{self.count}',
                                       'name': name, 'fields': fields}, status)


@pytest.fixture(scope='session')
def scene(sample) -> Iterator[Scene]:
    """Return the sample's bag, open."""
    scene = Scene(sample / 'bag')
    yield scene
    scene.close()


@pytest.fixture
def space(scene, tmp_path) -> Workspace:
    """Return an empty draft on the sample."""
    return Workspace(scene, tmp_path / 'site.yaml', tmp_path / 'init.yaml')


@pytest.fixture
def serving():
    """Return a function that serves something and returns a client."""
    @contextmanager
    def serve(**what: Any) -> Iterator[Client]:
        guard = Guard()
        with guard.bind(0) as sock, served(Studio(guard, **what), sock):
            yield Client(guard)
    return serve


@pytest.fixture
def client(space, serving) -> Iterator[Client]:
    """Return a client of a server with an empty draft."""
    with serving(workspace=space) as client:
        yield client


def write_passes(folder, count=3, lane='lane_0', updates=2, **more):
    """Write a run of some passes like ``replay``, with ``more`` added to each."""
    passes = [PassResult(
        track=k, lane=lane, first_ns=10**18 + k * 10**9, last_ns=10**18 + k * 10**9 + 10**8,
        pairs=updates, speed_mps=20.0 + 0.05 * k, speed_std_mps=0.1,
        verdict=Verdict.REJECTED if k % 10 == 9 else Verdict.MEASURED,
        reason='too_few_pairs' if k % 10 == 9 else '',
        smoothed={}, smoothed_std={}, **more) for k in range(count)]
    rows = [TrackUpdate(
        stamp_ns=10**18 + k * 10**9 + i * 10**8, track=k, lane=lane, state=TrackState.CONFIRMED,
        speed_mps=20.0, speed_std_mps=0.1, s_m=float(i), lateral_m=0.0,
        position_m=np.array([0.0, 0.0, 30.0]), position_cov_m2=np.eye(3), axes=np.eye(3),
        quad_left_px=np.zeros((4, 2)), quad_right_px=np.zeros((4, 2)))
        for k in range(count) for i in range(updates)]
    write_run(folder, rows, passes, {'seed': 0, 'input': {'bag_sha256': 'abc'}})
    return folder


@pytest.fixture(scope='session')
def replayed(sample, tmp_path_factory) -> Path:
    """Return the output of ``replay`` for the sample, with its violation and its database."""
    out = tmp_path_factory.mktemp('replayed') / 'run'
    assert main(['replay', str(sample / 'bag'), '--site', str(sample / 'site.yaml'), '--out',
                 str(out), '--no-plots', '--evidence', '--sqlite']) == 0
    return out


@pytest.fixture
def make_run():
    """Return a function that writes a run of some passes."""
    return write_passes
