# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""What the benchmark tells: each job counts after its first run, and every kernel is there."""
from __future__ import annotations

import sys
from types import SimpleNamespace

import pytest

from stereo_speed.io.bags import StereoBag
from stereo_speed.lab.evaluation import benchmarks
from stereo_speed.lab.evaluation.benchmarks import (
    filter_table, follower_table, kernel_table, medians, Scene)
from stereo_speed.pipeline.assembly import MeasuringSite
from stereo_speed.report.comparison import growth_plot
from stereo_speed.site.file import load_site
from stereo_speed.site.init_file import load_init


def test_jobs_take_turns_and_their_first_run_does_not_count(monkeypatch):
    order = []
    clock = iter([0, 1, 10, 15, 20, 23, 30, 37, 40, 42, 50, 56])  # s, before and after each call
    monkeypatch.setattr(benchmarks.time, 'process_time', lambda: next(clock))
    found = medians({name: lambda name=name: order.append(name) for name in 'ab'}, 3)
    assert order == list('ab' * 4)
    assert found == {'a': 2000.0, 'b': 6000.0}


def test_kernels_are_timed_compiled_and_plain():
    pytest.importorskip('numba')
    table = kernel_table(1)
    assert {str(row[0]).rpartition('.')[2] for row in table.rows} == {
        '_temporal', '_cross', 'views', 'shifted', 'mirrored', 'edges'}
    assert all(plain > 0 and ratio > 0 for _, plain, _, ratio in table.rows)


def test_the_filter_is_timed_without_a_peer_too(monkeypatch):
    monkeypatch.setitem(sys.modules, 'filterpy.monte_carlo', None)
    table = filter_table(1)
    assert [row[2] for row in table.rows] == ['not installed'] * 4
    assert all(row[1] > 0 for row in table.rows)


def test_one_vehicle_is_followed_beside_trackers_that_this_opencv_has(sample, monkeypatch):
    """Peers are given the front's box, and one view of each pair."""
    with StereoBag(sample / 'bag') as bag:
        pairs = list(bag.pairs())
        place = MeasuringSite.of(load_site(sample / 'site.yaml'), bag.rig)
    scene = Scene(place.rig, place, pairs[:3], load_init(sample / 'init.yaml'))
    seen = []
    peer = SimpleNamespace(init=lambda image, box: seen.append((image.shape, box)),
                           update=lambda image: seen.append(image.shape))
    monkeypatch.setattr(benchmarks.cv2, 'TrackerMIL_create', lambda: peer, raising=False)
    monkeypatch.delattr(benchmarks.cv2, 'TrackerCSRT_create', raising=False)
    ours, mil, csrt = follower_table(scene, 1).rows
    assert (ours[0], mil[0], csrt[0], csrt[2]) == (
        'ours', 'OpenCV MIL', 'OpenCV CSRT', 'not installed')
    assert ours[2] > mil[2] >= 0
    shape = (*pairs[0].left.shape, 3)
    # clicked from 384.7 to 429.5 px across and 309.3 to 323.8 px down
    assert seen == 2 * [(shape, (385, 309, 45, 14)), shape, shape]


def test_the_plot_is_a_picture(tmp_path):
    growth_plot(tmp_path / 'a.png', {'tracks': [(1, 2.0), (2, 4.0)]}, 'tracks')
    assert (tmp_path / 'a.png').read_bytes().startswith(b'\x89PNG')
