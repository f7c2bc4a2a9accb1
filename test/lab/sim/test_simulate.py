# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Whole sequences, and the files written from them."""
from __future__ import annotations

import csv
from dataclasses import replace
import subprocess
import sys

import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.io.bags import StereoBag
from stereo_speed.lab.sim import (
    circle_config, RigConfig, RIGS, simulate, straight_config, VehicleConfig)
from stereo_speed.lab.sim.scene import make_rig
from stereo_speed.lab.sim.write import rectification, write_bag
from stereo_speed.site.file import load_site
from stereo_speed.site.init_file import load_init
import yaml

SMALL = RigConfig(width_px=320, height_px=240, f_px=560.0)


@pytest.fixture(scope='module')
def short():
    """Return a short sequence on a curve, seen by a converging, distorted rig."""
    rig = replace(RIGS['distorted'], width_px=320, height_px=240, f_px=560.0, right_f_px=550.0)
    return simulate(circle_config(rig=rig, pairs=3, stamp_jitter_s=0.01),
                    np.random.default_rng(7))


def test_same_seed_same_sequence(short):
    again = simulate(short.config, np.random.default_rng(7))
    other = simulate(short.config, np.random.default_rng(8))
    assert again.site == short.site and again.init == short.init and again.truth == short.truth
    for one, two, three in zip(short.pairs, again.pairs, other.pairs):
        assert one.stamp_ns == two.stamp_ns
        np.testing.assert_array_equal(one.left, two.left)
        np.testing.assert_array_equal(one.right, two.right)
        assert not np.array_equal(one.left, three.left)


def test_full_passes_are_long_enough():
    for config, least in ((straight_config(rig=SMALL), 12), (circle_config(rig=SMALL), 10)):
        sequence = simulate(config, np.random.default_rng(0))
        assert len(sequence.pairs) == len(sequence.truth) >= least
        steps = np.diff([[row[key] for key in 'xyz'] for row in sequence.truth], axis=0)
        chord = np.linalg.norm(steps, axis=1) / 0.2
        assert chord == pytest.approx(sequence.truth[0]['path_speed'], rel=3e-3)


def test_noise_gain_drops_and_uneven_stamps():
    config = straight_config(
        rig=SMALL, noise_grey=0.0, right_gain=0.8, right_offset_grey=5.0, pairs=6, drop=(2,),
        stamp_jitter_s=0.02, right_stamp_jitter_s=3e-4)
    clean = simulate(config, np.random.default_rng(1))
    plain = simulate(replace(config, right_gain=1.0, right_offset_grey=0.0),
                     np.random.default_rng(1))
    noisy = simulate(replace(config, noise_grey=3.0), np.random.default_rng(1))
    assert [pair.index for pair in clean.pairs] == [0, 1, 2, 3, 4]
    steps = np.diff([pair.stamp_ns for pair in clean.pairs]) * 1e-9
    assert steps[1] > 0.3 and len(set(steps)) == 4
    assert all(0 < abs(p.right_stamp_ns - p.stamp_ns) <= 300_000 for p in clean.pairs)
    np.testing.assert_allclose(clean.pairs[0].right, plain.pairs[0].right * 0.8 + 5.0, atol=1.0)
    grain = noisy.pairs[0].left.astype(float) - clean.pairs[0].left
    assert grain.std() == pytest.approx(3.0, rel=0.03)


def test_two_vehicles_and_one_that_never_comes():
    two = straight_config(
        rig=SMALL, pairs=4,
        vehicles=(VehicleConfig(lane=0), VehicleConfig(lane=1, head_start_m=10.0)))
    sequence = simulate(two, np.random.default_rng(0))
    assert [row['vehicle'] for row in sequence.truth] == [0, 1] * 4
    assert len(sequence.init['vehicles']) == 2
    never = straight_config(rig=SMALL, vehicles=(VehicleConfig(head_start_m=500.0),), pairs=4)
    with pytest.raises(InputError, match='none whole in both views'):
        simulate(never, np.random.default_rng(0))


@pytest.mark.parametrize('name', sorted(RIGS))
def test_rectification_recovers_the_rig(name):
    rig = make_rig(RIGS[name])
    r1, r2, p1, p2 = rectification(rig)
    np.testing.assert_allclose(r2.T @ r1, rig.R, atol=1e-12)
    np.testing.assert_allclose(r2.T @ [p2[0, 3] / p2[0, 0], 0, 0], rig.t, atol=1e-12)
    # A point seen through the rectified cameras lies on one row.
    point = np.array([1.0, -2.0, 30.0])
    left, right = r1 @ point, r2 @ (rig.R @ point + rig.t)
    left, right = p1 @ [*left, 1.0], p2 @ [*(r1 @ point), 1.0]
    assert left[1] / left[2] == pytest.approx(right[1] / right[2])
    np.testing.assert_allclose(r2 @ (rig.R @ point + rig.t),
                               r1 @ point + [p2[0, 3] / p2[0, 0], 0, 0], atol=1e-12)


@pytest.mark.parametrize('storage, encoding', [
    ('mcap', 'mono8'), ('sqlite3', 'bgr8'), ('ros1', 'mono8'), ('mcap', 'rgba8'),
    ('sqlite3', 'bayer_grbg8'), ('ros1', 'mono16')])
def test_bag_recovers_the_sequence(short, tmp_path, storage, encoding):
    folder = write_bag(short, tmp_path / 'out', storage, encoding)
    with StereoBag(folder / ('bag.bag' if storage == 'ros1' else 'bag')) as bag:
        for side in ('left', 'right'):
            found, true = getattr(bag.rig, side), getattr(short.rig, side)
            np.testing.assert_array_equal(found.K, true.K)
            np.testing.assert_array_equal(found.D, true.D)
            assert found.model == true.model
        np.testing.assert_allclose(bag.rig.R, short.rig.R, atol=1e-12)
        np.testing.assert_allclose(bag.rig.t, short.rig.t, atol=1e-12)
        pairs = list(bag.pairs())
    assert [p.stamp_ns for p in pairs] == [p.stamp_ns for p in short.pairs]
    scale = 257 if encoding == 'mono16' else 1
    # A grey scene is its own mosaic, but interpolation smooths its noise and edges.
    near = 6 if encoding.startswith('bayer') else 0
    for found, true in zip(pairs, short.pairs):
        for side in ('left', 'right'):
            gap = getattr(found, side) / scale - getattr(true, side).astype(float)
            assert np.sqrt(np.mean(gap ** 2)) <= near


def test_compressed_bag_and_files(short, tmp_path):
    folder = write_bag(short, tmp_path / 'out', compressed=True)
    assert sorted(p.name for p in folder.iterdir()) == [
        'bag', 'init.yaml', 'site.yaml', 'truth.csv']
    assert [p.name for p in tmp_path.iterdir()] == ['out']
    with StereoBag(folder / 'bag') as bag:
        gap = next(iter(bag.pairs())).left.astype(float) - short.pairs[0].left
    assert np.sqrt(np.mean(gap ** 2)) < 3.0
    assert yaml.safe_load((folder / 'site.yaml').read_text()) == short.site
    assert yaml.safe_load((folder / 'init.yaml').read_text()) == short.init
    assert len(load_site(folder / 'site.yaml').lanes) == 2
    assert load_init(folder / 'init.yaml')[0].frame == 0
    with (folder / 'truth.csv').open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ['stamp', 'vehicle', 'speed', 'path_speed', 'lateral', 'x', 'y', 'z',
                             'width_px']
    for row, pair in zip(rows, short.pairs):
        whole, _, part = row['stamp'].partition('.')
        assert int(whole) * 10 ** 9 + int(part) * 1000 == pair.stamp_ns


def test_bad_requests_leave_no_files(short, tmp_path):
    for kwargs, match in (({'storage': 'zip'}, 'storage'), ({'encoding': 'yuv'}, 'encoding')):
        with pytest.raises(InputError, match=match):
            write_bag(short, tmp_path / 'out', **kwargs)
    assert not list(tmp_path.iterdir())
    (tmp_path / 'file').write_text('')
    with pytest.raises(InputError, match='something there already'):
        write_bag(short, tmp_path)


def _run(*arguments):
    return subprocess.run([sys.executable, '-m', 'stereo_speed', 'simulate', *arguments],
                          capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_command_line(tmp_path):
    out = tmp_path / 'pass'
    done = _run('--out', str(out), '--path', 'clothoid:0.004:0.03:40', '--speed', '28 mph',
                '--pairs', '2', '--seed', '3', '--storage', 'sqlite3', '--compressed')
    assert done.returncode == 0, done.stderr
    assert '2 pairs' in done.stdout
    with StereoBag(out / 'bag') as bag:
        assert len(list(bag.pairs())) == 2


@pytest.mark.parametrize('arguments, wanted', [
    (['--path', 'spiral'], '--path'), (['--speed', '55'], '--speed'),
    (['--lane', '2'], 'vehicle.lane'), (['--fps', '0'], '--fps')])
def test_command_line_refuses(tmp_path, arguments, wanted):
    done = _run('--out', str(tmp_path / 'pass'), *arguments)
    assert done.returncode == 2
    assert wanted in done.stderr and done.stderr.count('\n') == 1
    assert not list(tmp_path.iterdir())
