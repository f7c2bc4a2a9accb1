# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Records under review: figures, files, verification, and no access outside of them."""
from __future__ import annotations

import json
import shutil

import pytest
from stereo_speed.studio.evidence import EvidenceRun
from stereo_speed.studio.opening import open_runs

pytestmark = pytest.mark.slow


@pytest.fixture
def evidence(replayed, tmp_path):
    """Return a copy of the sample's record, in its folder, that a test may damage."""
    return shutil.copytree(replayed / 'evidence', tmp_path / 'evidence')


@pytest.fixture
def record(evidence):
    """Return the folder of the one record."""
    return next(path for path in evidence.iterdir() if path.is_dir())


def test_record_is_read(replayed, evidence, record):
    folder, beside = open_runs([replayed])
    assert (folder.kind, beside.kind, beside.name) == ('folder', 'evidence', 'run/evidence')
    run, = open_runs([evidence])
    said = json.loads((record / 'record.json').read_text())
    row, = run.rows()
    assert row['id'] == record.name and row['number'] == 1
    assert row['speed_mps'] == pytest.approx(folder.rows()[0]['speed_mps'], abs=1e-5)
    assert (row['considered'], row['limit'], row['unit']) == tuple(
        said['speed'][key] for key in ('considered', 'limit', 'unit'))
    opened = run.opened(0)
    assert [one['stamp_ns'] for one in opened.rows] == [
        one['stamp_ns'] for one in said['speed']['profile']]
    assert opened.more['std_matching_mps'] == pytest.approx(
        folder.rows()[0]['std_matching_mps'], abs=1e-5)
    assert run.files(0) == sorted(said['files'])
    found = run.file(0, run.files(0).index('close_up.jpg'))
    assert found.path.read_bytes() == (record / 'close_up.jpg').read_bytes()
    assert (found.media_type, found.shown) == ('image/jpeg', True)
    # a page of the record would be a page of this server: it is handed out, not shown
    assert not run.file(0, run.files(0).index('page.html')).shown
    alone, = open_runs([record])
    assert alone.rows()[0]['id'] == record.name and alone.file(0, 0) is not None


def test_verification_is_reported(evidence, record):
    run = EvidenceRun(evidence, 'evidence')
    found = run.verified()
    assert (found['faults'], found['records'], found['of']) == ([], 1, {})
    assert any('nothing is signed' in note for note in found['notes'])
    (record / 'close_up.jpg').write_bytes(b'another')
    found = run.verified()
    assert found['faults'] == [f'{record.name}/close_up.jpg was changed']
    assert found['of'] == {'0': found['faults']}
    (record / 'record.json').write_text('{}')
    row, = run.rows()
    assert row['id'] == record.name and row['speed_mps'] is None
    assert run.files(0) == [] and 'unreadable' in run.opened(0).more


def test_files_outside_a_record_are_not_served(evidence, record, tmp_path):
    """A record that lists foreign files, by name or through a link."""
    (tmp_path / 'secret.txt').write_text('secret')
    said = json.loads((record / 'record.json').read_text())
    own = said['files']['close_up.jpg']
    (record / 'link.png').symlink_to(tmp_path / 'secret.txt')
    said['files'] = {name: own for name in (
        '../../secret.txt', str(tmp_path / 'secret.txt'), 'link.png', '..', '', 'close_up.jpg')}
    (record / 'record.json').write_text(json.dumps(said))
    run = EvidenceRun(evidence, 'evidence')
    names = run.files(0)
    given = {name: run.file(0, index) for index, name in enumerate(names)}
    assert {name for name, file in given.items() if file} <= {'close_up.jpg'}
    assert run.file(0, len(names)) is None and run.file(7, 0) is None
    (evidence / 'elsewhere').symlink_to(record)
    assert [row['id'] for row in run.rows()] == [record.name]


def test_records_are_listed(serving, evidence, record):
    with serving(runs=open_runs([evidence])) as client:
        run = client.get('/api/runs/0')
        assert run['kind'] == 'evidence' and run['rows'][0]['id'] == record.name
        opened = client.get('/api/runs/0/pass/0')
        at = opened['files'].index('close_up.jpg')
        status, headers, body = client.ask('GET', f'/api/runs/0/pass/0/file/{at}')
        assert (status, headers['Content-Type']) == (200, 'image/jpeg')
        assert body == (record / 'close_up.jpg').read_bytes()
        page = opened['files'].index('page.html')
        _, headers, _ = client.ask('GET', f'/api/runs/0/pass/0/file/{page}')
        assert headers['Content-Type'] == 'application/octet-stream'
        assert headers['Content-Disposition'].startswith('attachment')
        assert headers['X-Content-Type-Options'] == 'nosniff'
        assert client.get('/api/runs/0/verified')['faults'] == []
        for path in ('pass/1', 'pass/0/file/999', 'pass/0/file/-1', 'pass/0/file/..%2f'):
            assert client.ask('GET', f'/api/runs/0/{path}')[0] == 404, path
