# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``map``: polygons to a map and its overlay, and bad polygons files."""
from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereo_speed.cli.main import main


@pytest.fixture()
def polygons(tmp_path):
    """Write a rectangle of 10 by 5 px."""
    path = tmp_path / 'polygons.yaml'
    path.write_text('stereo_speed_map: 1\nbackground: inaccessible\nregions:\n- kind: pathway'
                    '\n  polygon: [[9.5, 4.5], [19.5, 4.5], [19.5, 9.5], [9.5, 9.5]]\n')
    return path


def test_map_of_polygons(polygons, tmp_path, capsys):
    """A sixteenth of 40 by 20 px."""
    assert main(['map', str(polygons), '--size', '40x20', '--out', str(tmp_path / 'm.png')]) == 0
    drawn = cv2.imread(str(tmp_path / 'm.png'), cv2.IMREAD_UNCHANGED)
    wanted = np.zeros((20, 40), np.uint8)
    wanted[5:10, 10:20] = 255
    np.testing.assert_array_equal(drawn, wanted)
    assert cv2.imread(str(tmp_path / 'm_overlay.png')).shape == (20, 40, 3)
    assert 'pathway: 6.2 %' in capsys.readouterr().out


def test_map_has_the_size_of_its_image(polygons, tmp_path):
    image = np.full((30, 50, 3), 90, np.uint8)
    cv2.imwrite(str(tmp_path / 'image.png'), image)
    assert main(['map', str(polygons), '--image', str(tmp_path / 'image.png'), '--out',
                 str(tmp_path / 'm.png'), '--overlay', str(tmp_path / 'o.png')]) == 0
    assert cv2.imread(str(tmp_path / 'm.png'), cv2.IMREAD_UNCHANGED).shape == (30, 50)
    overlay = cv2.imread(str(tmp_path / 'o.png'))
    assert overlay.shape == image.shape and np.any(overlay != image)


@pytest.mark.parametrize(('options', 'words'), [
    (['--overlay', 'sub/../m.png', '--size', '40x20'], ['--overlay', 'm.png', '--out']),
    ([], ['--size', 'nothing', '--image']),
    (['--size', '40x20', '--image', 'image.png'], ['image.png', '50x30', '40x20']),
    (['--size', '40x20', '--image', 'polygons.png'], ['polygons.png', 'no such file']),
])
def test_bad_input(polygons, tmp_path, capsys, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    cv2.imwrite('image.png', np.zeros((30, 50, 3), np.uint8))
    assert main(['map', str(polygons), '--out', 'm.png', *options]) == 2
    error = capsys.readouterr().err
    lines = [line for line in error.splitlines() if line.startswith('error: ')]
    assert len(lines) == 1 and 'Traceback' not in error
    assert all(word in lines[0] for word in words), lines[0]
    assert not (tmp_path / 'm.png').exists()
