# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``replay-many`` gives the bytes of ``replay``, over processes and a cluster, despite kills."""
from __future__ import annotations

import json
import os
from pathlib import Path
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import time

import pytest
from stereo_speed.cli.main import main
from stereo_speed.cli.replay_many import folder_names
from stereo_speed.core.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENT = {**os.environ, 'PYTHONPATH': str(ROOT)}


@pytest.fixture(scope='module')
def bags(rewrite, tmp_path_factory):
    """Return five bags of 3 to 7 pairs."""
    folder = tmp_path_factory.mktemp('bags')
    return [rewrite(folder / f'bag{n}', pairs=3 + n) for n in range(5)]


@pytest.fixture(scope='module')
def options(sample):
    return ['--site', str(sample / 'site.yaml'), '--init', str(sample / 'init.yaml'),
            '--no-plots']


@pytest.fixture(scope='module')
def one_by_one(bags, options, tmp_path_factory):
    """Return the folder of what ``replay`` writes for each bag."""
    out = tmp_path_factory.mktemp('single')
    for bag in bags:
        assert main(['replay', str(bag), *options, '--out', str(out / bag.name)]) == 0
    return out


def assert_same_bytes(found: Path, wanted: Path) -> None:
    """Assert that two folders of runs are equal, file by file, hidden ones too."""
    for run in wanted.iterdir():
        assert sorted(os.listdir(found / run.name)) == sorted(os.listdir(run))
        for path in run.iterdir():
            assert (found / run.name / path.name).read_bytes() == path.read_bytes(), path


@pytest.mark.slow
@pytest.mark.flaky(reruns=2)  # it may be done before the kill
def test_killed_run_resumes_and_a_bad_bag_affects_only_itself(
        bags, options, one_by_one, tmp_path, capfd):
    bad = tmp_path / 'bad'
    bad.mkdir()
    for path in bags[0].iterdir():
        data = path.read_bytes()
        (bad / path.name).write_bytes(data[:len(data) // 2] if path.suffix == '.mcap' else data)
    out = tmp_path / 'out'
    argv = ['replay-many', str(bad), *map(str, bags), *options, '--out', str(out), '--jobs']
    started = subprocess.Popen([sys.executable, '-m', 'stereo_speed', *argv, '2'],
                               env=ENVIRONMENT, stderr=subprocess.DEVNULL,
                               stdout=subprocess.DEVNULL)
    journal = out / 'runs.jsonl'
    wait_for(lambda: journal.is_file() and '"files"' in journal.read_text(), started)
    started.kill()
    started.wait()
    assert not (out / 'passes.parquet').exists()
    # The killed run's processes end with it, so nothing of it is written from here on.
    done = set(finished(journal))
    assert 0 < len(done) < len(bags)
    assert main([*argv, '0']) == 2
    told = capfd.readouterr()
    assert told.err.splitlines()[-1].startswith(f'error: bad: {bad}: ')
    assert told.err.count('error: ') == 1
    assert '5 of 6 bags, 5 passes' in told.out
    assert_same_bytes(out, one_by_one)
    # Nothing that was finished before the kill was measured again.
    assert all(finished(journal).count(name) == 1 for name in done)
    rows = sqlite3.connect(out / 'passes.sqlite').execute('SELECT bag, pairs FROM passes')
    assert rows.fetchall() == [(f'bag{n}', 3 + n) for n in range(5)]


def finished(journal: Path) -> list[str]:
    """Return the bags that a journal has a run of."""
    rows = [json.loads(line) for line in journal.read_text().splitlines() if line.endswith('}')]
    return [row['key'] for row in rows if row['value']]


def wait_for(condition, process=None, seconds=300.0):
    """Wait for an event while the process that causes it is alive."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, 'the awaited event has not come'
        assert process is None or process.poll() is None, 'the process has ended'
        time.sleep(0.02)


@pytest.mark.slow
def test_only_changed_bags_are_measured_again(bags, options, tmp_path, rewrite):
    bag, other = tmp_path / 'bag', bags[0]
    shutil.copytree(bags[1], bag)
    argv = ['replay-many', str(bag), str(other), *options, '--out', str(tmp_path / 'out'),
            '--jobs', '0']
    journal = tmp_path / 'out' / 'runs.jsonl'

    def measured(*more):
        before = len(finished(journal)) if journal.is_file() else 0
        assert main([*argv, *more]) == 0
        return sorted(finished(journal)[before:])
    assert measured() == ['bag', 'bag0']
    assert measured() == []
    (tmp_path / 'out' / 'bag' / 'tracks.csv').write_text('cut')
    assert measured() == ['bag']
    shutil.rmtree(bag)
    shutil.copytree(bags[2], bag)
    assert measured() == ['bag']
    assert measured('--seed', '3') == ['bag', 'bag0']


@pytest.mark.parametrize(('paths', 'names'), [
    (['x/one', 'x/two.mcap'], ['one', 'two']),
    (['x/bag', 'y/bag', 'y/other'], ['x-bag', 'y-bag', 'other']),
    (['p/x/bag', 'q/x/bag'], ['p-x-bag', 'q-x-bag']),
])
def test_folders_are_named_after_the_bags(tmp_path, paths, names):
    for path in paths:
        (tmp_path / path).mkdir(parents=True) if '.' not in path else (tmp_path / path).touch()
    assert list(folder_names([tmp_path / path for path in paths])) == names


def test_duplicate_bag_is_refused(tmp_path):
    with pytest.raises(InputError, match='twice'):
        folder_names([tmp_path / 'a', tmp_path / 'b' / '..' / 'a'])


def test_bad_site_is_one_line_for_all_bags(bags, options, tmp_path, capsys):
    site = tmp_path / 'site.yaml'
    site.write_text('stereo_speed_site: 1\n')
    argv = ['replay-many', *map(str, bags), '--site', str(site), '--out', str(tmp_path / 'out')]
    assert main(argv) == 2
    assert capsys.readouterr().err.count('\n') == 1


# -- a cluster --------------------------------------------------------------------------------


@pytest.fixture
def cluster(tmp_path):
    """Start a scheduler and two workers; return its address and the workers' processes."""
    pytest.importorskip('distributed', reason='Dask is not installed (extra: cluster)')
    with socket.socket() as probe:
        probe.bind(('127.0.0.1', 0))
        port = probe.getsockname()[1]
    address = f'tcp://127.0.0.1:{port}'
    quiet = {**ENVIRONMENT, 'OMP_NUM_THREADS': '1', 'DASK_DISTRIBUTED__DASHBOARD__LINK': '',
             'DASK_DISTRIBUTED__WORKER__MEMORY__TERMINATE': 'false'}
    command = [sys.executable, '-m', 'distributed.cli.dask_scheduler', '--host', '127.0.0.1',
               '--port', str(port), '--no-dashboard', '--no-jupyter']
    logs = (tmp_path / 'scheduler.log').open('w'), (tmp_path / 'workers.log').open('w')
    processes = [subprocess.Popen(command, env=quiet, stdout=logs[0], stderr=logs[0])]
    worker = [sys.executable, '-m', 'distributed.cli.dask_worker', address, '--nthreads', '1',
              '--no-nanny', '--no-dashboard', '--local-directory', str(tmp_path)]
    processes += [subprocess.Popen(worker, env=quiet, stdout=logs[1], stderr=logs[1])
                  for _ in range(2)]
    try:
        yield address, processes[1:]
    finally:
        for process in processes:
            process.kill()
            process.wait()
        for log in logs:
            log.close()


@pytest.mark.slow
@pytest.mark.flaky(reruns=2)  # it may be done before the kill
def test_cluster_gives_the_same_bytes_despite_a_killed_worker(
        cluster, bags, options, one_by_one, tmp_path):
    address, (first, second) = cluster
    out = tmp_path / 'out'
    run = subprocess.Popen(
        [sys.executable, '-m', 'stereo_speed', 'replay-many', *map(str, bags), *options, '--out',
         str(out), '--dask', address], env=ENVIRONMENT, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True)
    # Both workers are at work when one bag is done: its worker has taken the next.
    wait_for(lambda: list(out.glob('*/summary.json')), run)
    os.kill(first.pid, signal.SIGKILL)
    told, errors = run.communicate(timeout=300)
    assert (run.returncode, errors) == (0, '')
    assert '5 of 5 bags, 5 passes' in told
    assert second.poll() is None
    assert_same_bytes(out, one_by_one)


def test_missing_scheduler_is_one_line(bags, options, tmp_path, capsys, monkeypatch):
    pytest.importorskip('distributed', reason='Dask is not installed (extra: cluster)')
    monkeypatch.setattr('stereo_speed.batch.cluster._CONNECT_S', 1)
    assert main(['replay-many', str(bags[0]), *options, '--out', str(tmp_path), '--dask',
                 'tcp://127.0.0.1:9']) == 2
    error = capsys.readouterr().err
    assert error.startswith('error: --dask: scheduler: found tcp://127.0.0.1:9')
    assert error.count('\n') == 1
