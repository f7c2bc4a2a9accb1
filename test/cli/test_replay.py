# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``replay`` on the sample: its files, its table, and identical bytes when repeated."""
from __future__ import annotations

import csv
from dataclasses import replace
import json
import os
from pathlib import Path
import subprocess
import sys

import cv2
import pytest
from stereo_speed.cli.main import main
from stereo_speed.core.compiled import VARIABLE
from stereo_speed.core.units import MPH_MPS
from stereo_speed.io.results import PASS_COLUMNS, TRACK_COLUMNS
from stereo_speed.site.file import load_site


@pytest.fixture(scope='module')
def run(tmp_path_factory, sample):
    """Return a function that replays the sample into a new folder."""
    def replay(*more: str) -> Path:
        out = tmp_path_factory.mktemp('run')
        assert main(['replay', str(sample / 'bag'), '--site', str(sample / 'site.yaml'),
                     '--init', str(sample / 'init.yaml'), '--out', str(out), *more]) == 0
        return out
    return replay


@pytest.fixture(scope='module')
def out(run):
    return run()


def rows(path: Path) -> list[dict[str, str]]:
    """Read a CSV file."""
    with path.open(newline='') as file:
        return list(csv.DictReader(file))


def test_files(out):
    assert sorted(path.name for path in out.iterdir()) == [
        'passes.csv', 'road.png', 'speed.png', 'strip.png', 'summary.json', 'tracks.csv']


def test_tables(out):
    tracks, passes = rows(out / 'tracks.csv'), rows(out / 'passes.csv')
    assert tuple(tracks[0])[:len(TRACK_COLUMNS)] == TRACK_COLUMNS
    assert tuple(passes[0])[:len(PASS_COLUMNS)] == PASS_COLUMNS
    assert len(passes) == 1
    assert {row['track'] for row in tracks} == {passes[0]['track']}
    assert passes[0]['verdict'] == 'measured'
    assert float(passes[0]['speed_mps']) / MPH_MPS == pytest.approx(55.0, abs=0.8)


def test_readings_agree_with_the_truth(out, sample):
    """In the second half no confirmed reading is off by more than 1.2 mph."""
    truth = {round(float(row['stamp']) * 1e3): float(row['speed'])
             for row in rows(sample / 'truth.csv')}
    late = [row for row in rows(out / 'tracks.csv') if row['state'] == 'confirmed'][-6:]
    assert len(late) == 6
    for row in late:
        true = truth[round(int(row['stamp_ns']) / 1e6)]
        assert abs(float(row['speed_mps']) - true) < 1.2 * MPH_MPS


def test_summary(out):
    summary = json.loads((out / 'summary.json').read_text())
    assert summary['seed'] == 0
    assert summary['parameters']['particles'] == 400
    assert summary['pairing']['pairs'] == 12
    assert len(summary['input']['bag_sha256']) == 64
    assert {'versions', 'timings', 'tracker', 'passes'} <= set(summary)
    assert abs(summary['focus']['right_blur_px']) < 0.5


def test_same_run_gives_the_same_bytes(run, out):
    again = run()
    for path in out.iterdir():
        assert path.read_bytes() == (again / path.name).read_bytes(), path.name


def test_options(run, out, capsys):
    other = run('--seed', '7', '--particles', '150', '--no-plots')
    assert not list(other.glob('*.png'))
    assert json.loads((other / 'summary.json').read_text())['parameters']['particles'] == 150
    assert (other / 'tracks.csv').read_bytes() != (out / 'tracks.csv').read_bytes()
    printed = capsys.readouterr().out
    assert 'mph' in printed
    assert 'km/h' in printed
    assert 'ms per pair' in printed


def test_later_run_leaves_no_files_of_an_older_one(tmp_path, sample, short_bag):
    (tmp_path / 'speed.png').write_bytes(b'old')
    (tmp_path / 'notes.txt').write_text('mine')
    assert main(['replay', str(short_bag), '--site', str(sample / 'site.yaml'), '--no-plots',
                 '--init', str(sample / 'init.yaml'), '--out', str(tmp_path)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        'notes.txt', 'passes.csv', 'summary.json', 'tracks.csv']


def test_unannotated_vehicle_is_detected(tmp_path, sample):
    assert main(['replay', str(sample / 'bag'), '--site', str(sample / 'site.yaml'),
                 '--out', str(tmp_path), '--no-plots']) == 0
    tracks, (only,) = rows(tmp_path / 'tracks.csv'), rows(tmp_path / 'passes.csv')
    assert only['verdict'] == 'measured' and {row['track'] for row in tracks} == {only['track']}
    assert float(only['speed_mps']) / MPH_MPS == pytest.approx(55.0, abs=0.5)
    # Confirmed within its first 4 pairs of 60 px: it comes from 44 px, 12 pairs.
    assert sum(row['state'] == 'confirmed' for row in tracks) >= 7
    assert json.loads((tmp_path / 'summary.json').read_text())['input']['init_sha256'] is None


def test_camera_out_of_focus_is_reported(tmp_path, sample, rewrite, capsys):
    def change(topic, number, msg):
        if topic != '/stereo/right/image_raw/compressed':
            return msg
        image = cv2.imdecode(msg.data, cv2.IMREAD_UNCHANGED)
        jpeg = cv2.imencode('.jpg', cv2.GaussianBlur(image, (0, 0), 2.0))[1]
        return replace(msg, data=jpeg.ravel())
    bag = rewrite(tmp_path / 'bag', change)
    assert main(['replay', str(bag), '--site', str(sample / 'site.yaml'), '--no-plots',
                 '--init', str(sample / 'init.yaml'), '--out', str(tmp_path / 'out')]) == 0
    focus = json.loads((tmp_path / 'out' / 'summary.json').read_text())['focus']
    assert focus['looks'] == 1 and focus['right_blur_px'] == pytest.approx(2.0, abs=0.15)
    assert 'the right camera is out of focus' in capsys.readouterr().out


@pytest.mark.parametrize('tracker', ['kalman', 'triangulation'])
def test_other_trackers_measure_the_same_pass(run, tracker):
    folder = run('--tracker', tracker, '--no-plots')
    assert json.loads((folder / 'summary.json').read_text())['tracker'] == tracker
    last = rows(folder / 'tracks.csv')[-1]
    assert abs(float(last['speed_mps']) - 55 * MPH_MPS) < 0.1 * 55 * MPH_MPS


def test_refined_site_is_kept_and_never_overwrites_its_source(tmp_path, sample, short_bag, capsys):
    site = tmp_path / 'site.yaml'
    site.write_bytes((sample / 'site.yaml').read_bytes())
    args = ['replay', str(short_bag), '--site', str(site), '--init', str(sample / 'init.yaml'),
            '--refine-site', '--no-plots', '--out']
    assert main([*args, str(tmp_path)]) == 2
    assert 'overwrite' in capsys.readouterr().err
    assert site.read_bytes() == (sample / 'site.yaml').read_bytes()
    assert main([*args, str(tmp_path / 'out')]) == 0
    printed = json.loads((tmp_path / 'out' / 'summary.json').read_text())['refinement']
    assert set(printed['turn_deg']) == {'pan', 'tilt', 'roll'}
    assert all(max(px) < 0.15 for px in printed['residual_px'].values())
    assert load_site(tmp_path / 'out' / 'site.yaml').correction is not None


@pytest.mark.slow
def test_plain_kernels_measure_the_same_speed_as_compiled_ones(sample, tmp_path):
    """
    They add up in another order, so results differ by rounding.

    Both draw the same particles, so no result may differ by a notable part of its 1-sigma.
    """
    found = {}
    for choice in ('compiled', 'plain'):  # one choice counts for a whole process
        out = tmp_path / choice
        subprocess.run(
            [sys.executable, '-m', 'stereo_speed', 'replay', str(sample / 'bag'), '--site',
             str(sample / 'site.yaml'), '--out', str(out), '--no-plots'],
            env={**os.environ, VARIABLE: choice}, check=True, stdout=subprocess.DEVNULL)
        summary = json.loads((out / 'summary.json').read_text())
        assert summary['versions']['kernels'].startswith(choice)
        found[choice], = rows(out / 'passes.csv')
    plain, compiled = found['plain'], found['compiled']
    assert plain['verdict'] == compiled['verdict'] == 'measured'
    std_mps = float(compiled['speed_std_mps'])
    for column in ('speed_mps', 'speed_std_mps', 'second_mps'):
        assert float(plain[column]) == pytest.approx(float(compiled[column]), abs=0.01 * std_mps)
