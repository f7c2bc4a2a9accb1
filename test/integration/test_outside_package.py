# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Trackers and detectors of another installed package, run by name."""
from __future__ import annotations

import csv
import json
import os
from pathlib import Path
import subprocess
import sys

import pytest
from stereo_speed.core.units import MPH_MPS
from stereo_speed.io.truth import read_truth

OUTSIDE = Path(__file__).with_name('outside_package')
TIMEOUT_S = 120.0


@pytest.fixture(scope='module')
def outside(tmp_path_factory):
    """Install the package into a folder of its own."""
    source, target = (tmp_path_factory.mktemp(name) for name in ('source', 'site-packages'))
    for name in ('setup.py', 'outside_speed.py'):
        (source / name).write_text((OUTSIDE / name).read_text())
    subprocess.run([sys.executable, '-m', 'pip', 'install', '--quiet', '--no-index', '--no-deps',
                    '--no-build-isolation', '--target', str(target), str(source)],
                   check=True, timeout=TIMEOUT_S)
    return target


@pytest.fixture
def environment(outside, monkeypatch):
    """Let child processes find the package, as if it was installed with the others."""
    root = Path(__file__).resolve().parents[2]
    monkeypatch.setenv('PYTHONPATH', os.pathsep.join([str(root), str(outside)]))


def replay(sample, out, *options):
    """Run ``replay`` in a separate process."""
    return subprocess.run(
        [sys.executable, '-m', 'stereo_speed', 'replay', str(sample / 'bag'), '--site',
         str(sample / 'site.yaml'), '--out', str(out), '--no-plots', *options],
        capture_output=True, text=True, timeout=TIMEOUT_S)


def test_both_run_in_replay_with_their_parameters(sample, environment, tmp_path):
    config = tmp_path / 'config.yaml'
    config.write_text('trackers: {outside_clock: {speed_mps: 12.5}}\n'
                      'detectors: {outside_gate: {gate_m: 25.0, at_pair: 1}}\n')
    done = replay(sample, tmp_path / 'out', '--tracker', 'outside_clock', '--detector',
                  'outside_gate', '--config', str(config))
    assert done.returncode == 0, done.stderr
    rows = list(csv.DictReader((tmp_path / 'out' / 'tracks.csv').open()))
    assert {float(r['speed_mps']) for r in rows} == {12.5}
    assert float(rows[0]['s_m']) == pytest.approx(25.0, abs=0.01)
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert summary['tracker_parameters'] == {'speed_mps': 12.5}
    assert summary['detector_parameters'] == {'gate_m': 25.0, 'at_pair': 1}
    one, = csv.DictReader((tmp_path / 'out' / 'passes.csv').open())
    # The tracker follows a clock to where no vehicle is: both views show the road there.
    assert (one['verdict'], one['reason'], one['speed_mps']) == ('rejected', 'views_disagree', '')


@pytest.mark.parametrize(('options', 'text', 'words'), [
    (['--tracker', 'outside_clock'], 'trackers: {outside_clock: {pace: 3}}',
     'trackers.outside_clock.pace'),
    (['--tracker', 'outside_clock'], 'trackers: {outside_clock: {speed_mps: 500}}',
     'trackers.outside_clock.speed_mps: found 500'),
    (['--detector', 'outside_radar'], '{}', 'outside_gate'),
], ids=['key', 'bounds', 'name'])
def test_errors_are_named(options, text, words, sample, environment, tmp_path):
    config = tmp_path / 'config.yaml'
    config.write_text(text)
    done = replay(sample, tmp_path / 'out', *options, '--config', str(config))
    assert done.returncode == 2 and done.stderr.count('\n') == 1, done.stderr
    assert words in done.stderr


def test_tracker_is_evaluated_with_others(sample, environment, tmp_path):
    done = subprocess.run(
        [sys.executable, '-m', 'stereo_speed', 'evaluate', str(sample), '--trackers',
         'outside_clock', '--seeds', '1', '--particles', '100', '--jobs', '1', '--out',
         str(tmp_path)], capture_output=True, text=True, timeout=TIMEOUT_S)
    assert done.returncode == 0, done.stderr
    row, = csv.DictReader((tmp_path / '0_straight55.csv').open())
    assert row['tracker'] == 'outside_clock'
    assert float(row['truth, mph']) == pytest.approx(55.0, abs=0.01)
    assert 0 <= float(row['sd, mph']) < 1e-6  # the same speed in every pair


def test_both_run_in_the_tracker_node(sample, environment, private_graph):
    pytest.importorskip('rclpy')
    from stereo_speed.cli.demo import live
    readings, _ = live(
        sample, sample / 'site.yaml', 3, 2.0, read_truth(sample / 'truth.csv')[0],
        parameters=['tracker:=outside_clock', 'trackers.outside_clock.speed_mps:=11.0',
                    'detector:=outside_gate', 'detectors.outside_gate.gate_m:=20.0'])
    assert len(readings) >= 3
    assert {speed / MPH_MPS for _, _, speed, _ in readings} == {11.0 / MPH_MPS}
