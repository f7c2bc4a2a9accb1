# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The server: steps and files over HTTP, messages to pages, runs."""
from __future__ import annotations

import asyncio
import json
import threading
import time

import aiohttp
import cv2
import numpy as np
import pytest
from stereo_speed.io.pass_log import PassLog
from stereo_speed.studio.live import LiveReading, LiveState
from stereo_speed.studio.opening import open_runs
from stereo_speed.studio.runs import Run

WAIT_S = 60.0


def wait(condition, seconds=WAIT_S):
    """Wait for automatic actions of the server."""
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.05)
    assert condition()


def test_step_changes_the_draft_and_is_checked(client, space):
    client.step('add_line')
    client.step('add_point', line=1, view='left', at=[400.0, 300.0])
    state = client.get('/api/state')
    assert state['workspace']['draft']['lines'][0]['left'] == [
        {'u': 400.0, 'v': 300.0, 'std_px': None}]
    assert state['workspace']['version'] == 2 and state['workspace']['unsaved']
    wait(lambda: any('1 points in the left' in note['text'] for note in
                     client.get('/api/state')['figures']['notes']))


def test_click_snaps_to_the_marking(client, sample):
    """Some pixels beside the right edge line of the sample."""
    client.step('add_line')
    client.step('add_point', line=1, view='left', at=[441.26 + 4, 440.84 + 1], snap=True)
    client.step('add_point', line=1, view='left', at=[558.66 - 3, 608.06 + 1], snap=True)
    points = client.get('/api/state')['workspace']['draft']['lines'][0]['left']
    ends = np.array([[441.26, 440.84], [558.66, 608.06]])
    way = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    for point in points:
        off = np.array([point['u'], point['v']]) - ends[0]
        assert abs(off[0] * way[1] - off[1] * way[0]) < 0.6  # clicks scatter by 0.3 px
        assert 0 < point['std_px'] < 0.3


def test_bad_requests_are_one_line(client, space):
    assert client.step('delete_line', status=400, line=3)['error'] == \
        'line: found number 3, wanted a line of this site'
    for body in (b'{', b'[]', b'{"id": 1}', b'{"id": "1", "name": "undo", "fields": 3}',
                 b'{"id": "1", "name": "undo", "fields": {}, "more": 1}', b'[' * 100000,
                 b'{"id": "a", "name": "add_point", "fields": {"line": NaN}}', b'\xff'):
        status, _, answer = client.ask('POST', '/api/step', body, Content_Type='application/json')
        assert status == 400 and '\n' not in json.loads(answer)['error'], body[:30]
    assert client.ask('POST', '/api/step', b'{}', Content_Type='text/plain')[0] == 415
    assert client.ask('POST', '/api/step', b' ' * 2**21,
                      Content_Type='application/json')[0] == 413
    assert space.version == 0


def test_invalid_site_is_not_saved(client, space):
    client.step('add_line')
    error = client.post('/api/save', {'what': 'site'}, 400)['error']
    assert error == ('lines.line_0: found 0 left and 0 right points, '
                     'wanted two or more in each view')
    assert not space.site_path.exists()


def test_images_equal_those_of_the_bag(client, scene):
    _, headers, data = client.ask('GET', '/api/frame/3/right')
    assert headers['Content-Type'] == 'image/png'
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    pair = scene.thread.submit(scene.pair, 3).result()
    np.testing.assert_array_equal(image, pair.right)
    assert pair.index == 3
    assert client.ask('GET', '/api/frame/12/left')[0] == 400
    answer = client.post('/api/epipolar', {'view': 'left', 'at': [412.6, 306.7]})
    assert len(answer['curve']) > 5 and answer['on_road'] is None


def test_pages_are_notified_of_changes_by_others(client):
    async def watch():
        headers = {**client.headers, 'Origin': f'http://127.0.0.1:{client.guard.port}'}
        address = f'http://127.0.0.1:{client.guard.port}/api/socket'
        async with aiohttp.ClientSession(headers=headers) as session:
            async with session.ws_connect(address) as one, session.ws_connect(address) as two:
                assert (await one.receive_json(timeout=WAIT_S))['kind'] == 'state'
                await two.receive_json(timeout=WAIT_S)
                await asyncio.to_thread(client.step, 'add_line')
                for page in (one, two):
                    told = await page.receive_json(timeout=WAIT_S)
                    assert told['kind'] == 'draft'
                    assert told['workspace']['draft']['lines'][0]['name'] == 'line_0'
                    assert (await page.receive_json(timeout=WAIT_S))['kind'] == 'figures'
            # one that comes later sees all of it
            async with session.ws_connect(address) as late:
                state = await late.receive_json(timeout=WAIT_S)
                assert state['workspace']['version'] == 1
    asyncio.run(watch())


def test_missing_run_does_not_affect_the_others(serving, tmp_path, make_run):
    with PassLog(tmp_path / 'log.sqlite'):
        pass
    runs = open_runs([tmp_path / 'log.sqlite', make_run(tmp_path / 'run')])
    with serving(runs=runs) as client:
        assert [run['number'] for run in client.get('/api/state')['runs']] == [0, 1]
        (tmp_path / 'log.sqlite').unlink()
        assert [run['number'] for run in client.get('/api/state')['runs']] == [1]


class Waiting(Run):
    """A run whose database is locked by a writer."""

    def __init__(self):
        super().__init__('waiting', 'log')
        self.asked, self.free = threading.Event(), threading.Event()

    def overview(self):
        self.asked.set()
        assert self.free.wait(WAIT_S)
        return super().overview()


def test_locked_run_blocks_nobody(serving):
    run, answers = Waiting(), []
    with serving(runs=[run]) as client:
        page = threading.Thread(target=lambda: answers.append(client.get('/api/state')))
        page.start()
        assert run.asked.wait(WAIT_S)
        assert client.ask('GET', '/')[0] == 200 and not answers
        run.free.set()
        page.join(WAIT_S)
    assert answers[0]['runs'] == [{'number': 0, 'name': 'waiting', 'kind': 'log'}]


def test_runs_are_listed(serving, tmp_path, make_run):
    runs = open_runs([make_run(tmp_path / 'run', lane='<img src=x onerror=alert(1)>')])
    with serving(runs=runs) as client:
        run = client.get('/api/runs/0')
        assert run['rows'][0]['lane'] == '<img src=x onerror=alert(1)>'
        assert not run['frames']
        assert len(client.get('/api/runs/0/pass/1')['rows']) == 2
        status, headers, text = client.ask('POST', '/api/runs/0/table', b'{"keys": [0, 1, 2]}',
                                           Content_Type='application/json')
        assert text == (tmp_path / 'run' / 'passes.csv').read_bytes()
        assert 'attachment' in headers['Content-Disposition']
        for keys in ([], ['0'], [True], [-1], [3], 0):
            assert 'keys' in client.post('/api/runs/0/table', {'keys': keys}, 400)['error']
        for path in ('/api/runs/1', '/api/runs/0/pass/77', '/api/runs/0/plot/speed.png',
                     '/api/runs/0/verified', '/api/runs/0/pass/0/file/0'):
            assert client.ask('GET', path)[0] == 404
        assert client.step('add_line', status=400)['error'] == \
            'bag: found none, wanted a bag to draw on'


def test_live_data_is_sent(serving):
    live = LiveState()

    async def watch(client):
        async with aiohttp.ClientSession(headers=client.headers) as session:
            async with session.ws_connect(
                    f'http://127.0.0.1:{client.guard.port}/api/socket') as page:
                live.add_reading(LiveReading('vehicle_0', 5, 24.5, 0.1))
                for _ in range(20):
                    told = await page.receive_json(timeout=WAIT_S)
                    if told['kind'] == 'live' and told['readings']:
                        return told
    with serving(live=live) as client:
        assert client.get('/api/state')['has_live']
        assert client.get('/api/live')['stale']
        assert asyncio.run(watch(client))['readings'][0]['speed_mps'] == 24.5
        assert client.ask('GET', '/api/live/overlay/left')[0] == 404
        live.add_image('left', b'\xff\xd8jpeg')
        assert client.ask('GET', '/api/live/overlay/left')[2] == b'\xff\xd8jpeg'


@pytest.mark.parametrize('name', ['index.html', 'app.js', 'style.css', 'icon.svg'])
def test_page_is_part_of_the_package(client, name):
    status, headers, body = client.ask('GET', f'/web/{name}')
    assert status == 200 and body
    assert headers['Content-Type'].split(';')[0] in (
        'text/html', 'text/javascript', 'text/css', 'image/svg+xml')
