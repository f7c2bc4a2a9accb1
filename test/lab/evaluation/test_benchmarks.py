# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The benchmark: jobs are timed after their first run, and every kernel is included."""
from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from stereo_speed.io.bags import StereoBag
from stereo_speed.io.images import grey_from_message
from stereo_speed.lab.evaluation import benchmarks
from stereo_speed.lab.evaluation.benchmarks import (
    _image_messages, decode_table, filter_table, follower_table, kernel_table, medians, Scene)
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
        '_temporal', '_cross', 'views', 'shifted', 'mirrored', 'edges', 'feet_on_lines',
        'pixels_of_lines', 'along'}
    assert all(plain > 0 and ratio > 0 for _, plain, _, ratio in table.rows)


def test_filter_is_timed_without_a_peer_too(monkeypatch):
    monkeypatch.setitem(sys.modules, 'filterpy.monte_carlo', None)
    table = filter_table(1)
    assert [row[2] for row in table.rows] == ['not installed'] * 4
    assert all(row[1] > 0 for row in table.rows)


def test_one_vehicle_is_tracked_beside_available_opencv_trackers(sample, monkeypatch):
    """Peers get the front's box, and one view of each pair."""
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


def scene_of(image):
    """Return a scene that only needs an image."""
    return Scene(None, None, [SimpleNamespace(left=image)], ())


def test_decoded_image_equals_the_original():
    """For lossless formats; a mosaic of one colour is a grey image."""
    image = np.random.default_rng(4).integers(0, 256, (24, 32), dtype=np.uint8)
    messages = _image_messages(image)
    for name in ('png, 8 bits', 'mono8', 'bgr8'):
        assert np.array_equal(grey_from_message(messages[name], ''), image)
    for name in ('png, 16 bits', 'mono16'):
        found = grey_from_message(messages[name], '')
        assert found.dtype == np.uint16 and np.array_equal(found, 257 * image.astype(np.uint16))
    even = _image_messages(np.full((24, 32), 90, np.uint8))
    assert all(np.abs(grey_from_message(even[name], '').astype(int) - 90).max() <= 1
               for name in ('jpeg, 8 bits', 'bayer_rggb8'))


def test_decoding_is_timed_beside_installed_peers(monkeypatch):
    """Each gets the same messages; peers that are missing or do not support one are marked."""
    image, asked = np.zeros((24, 32), np.uint8), []
    peer = SimpleNamespace(message_to_cvimage=lambda msg, kind: asked.append(
        (getattr(msg, 'encoding', 'file'), kind)))
    monkeypatch.setattr(benchmarks, '_installed', {'rosbags.image': peer}.get)
    table = decode_table(scene_of(image), 1)
    files, raw = table.rows[:3], table.rows[3:]
    assert [row[0] for row in raw] == ['mono8', 'mono16', 'bayer_rggb8', 'bgr8']
    assert all(row[1] > 0 and row[3] >= 0 and row[4] == 'not installed' for row in table.rows)
    assert all(row[2] > 0 for row in files) and all(row[2] is None for row in raw)
    assert set(asked) == {('file', None), ('mono8', None), ('mono16', None),
                          ('bayer_rggb8', 'mono8'), ('bgr8', 'mono8')}
    pillow = pytest.importorskip('PIL.Image')
    monkeypatch.setattr(benchmarks, '_installed', {'PIL.Image': pillow}.get)
    table = decode_table(scene_of(image), 1)
    assert all(row[3] == 'not installed' for row in table.rows)
    assert [row[4] is None for row in table.rows] == 3 * [False] + 4 * [True]
    deep = _image_messages(image + np.uint8(3))['png, 16 bits'].data
    assert np.all(benchmarks._by_pillow(pillow, deep) == 3 * 257)


def test_missing_peer_is_none(monkeypatch):
    monkeypatch.setitem(sys.modules, 'rosbags.image', None)
    assert benchmarks._installed('rosbags.image') is None
    assert benchmarks._installed('json').loads('1') == 1


def test_plot_is_a_picture(tmp_path):
    growth_plot(tmp_path / 'a.png', {'tracks': [(1, 2.0), (2, 4.0)]}, 'tracks')
    assert (tmp_path / 'a.png').read_bytes().startswith(b'\x89PNG')
