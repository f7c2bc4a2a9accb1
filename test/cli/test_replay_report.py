# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The files that ``replay --report --video`` writes beside the tables."""
from __future__ import annotations

import re

import cv2
import pytest
from stereo_speed.cli.main import main


@pytest.fixture(scope='module')
def outs(sample, tmp_path_factory):
    """Return the folders of two identical runs."""
    out = tmp_path_factory.mktemp('report')
    for name in ('a', 'b'):
        assert main(['replay', str(sample / 'bag'), '--site', str(sample / 'site.yaml'), '--init',
                     str(sample / 'init.yaml'), '--out', str(out / name), '--particles', '60',
                     '--no-plots', '--report', '--video', '--units', 'km/h']) == 0
    return out / 'a', out / 'b'


def test_report_is_self_contained(outs):
    page = (outs[0] / 'report.html').read_text()
    assert sorted(path.name for path in outs[0].iterdir()) == [
        'passes.csv', 'report.html', 'summary.json', 'tracks.csv', 'video.avi']
    sources = re.findall(r'(?:src|href)="([^"]*)"', page)
    assert len(sources) >= 5 and all(source.startswith('data:image/') for source in sources)
    assert '<script' not in page and 'url(' not in page
    for said in ('speed, km/h', 'lane_0', 'second estimate', 'Settings', 'bag_sha256', 'limit'):
        assert said in page
    assert re.search(r'<td>88\.\d\d</td>', page)  # 55 mph


def test_video_has_every_pair(outs):
    video, count = cv2.VideoCapture(str(outs[0] / 'video.avi')), 0
    while video.read()[0]:
        count += 1
    assert count == 12
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(5.0, abs=0.1)


def test_same_run_gives_the_same_bytes(outs):
    for name in ('report.html', 'video.avi'):
        assert (outs[0] / name).read_bytes() == (outs[1] / name).read_bytes()


def test_later_run_without_them_removes_them(outs, sample):
    assert main(['replay', str(sample / 'bag'), '--site', str(sample / 'site.yaml'), '--init',
                 str(sample / 'init.yaml'), '--out', str(outs[1]), '--particles', '60',
                 '--no-plots']) == 0
    assert sorted(path.name for path in outs[1].iterdir()) == [
        'passes.csv', 'summary.json', 'tracks.csv']
