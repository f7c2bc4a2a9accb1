# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Cameras and rigs from CameraInfo, checked against OpenCV's stereoRectify."""
import cv2
import numpy as np
import pytest

from stereo_speed.core.errors import CalibrationError
from stereo_speed.io.camera_info import (
    camera_from_info, check_image_size, rig_from_info, same_calibration)


@pytest.fixture(params=['ros1', 'ros2'])
def make(request, bags):
    return getattr(bags, request.param)


def test_ideal_rig_by_hand(make):
    rig = rig_from_info(make.info(0, 'left'), make.info(0, 'right'), 'bag')
    np.testing.assert_array_equal(rig.R, np.eye(3))
    np.testing.assert_allclose(rig.t, [-0.5, 0, 0])
    assert rig.baseline_m == pytest.approx(0.5)
    assert rig.frame_id == 'stereo_left_optical_frame'
    assert (rig.left.name, rig.right.name) == ('left', 'right')
    # a point 10 m ahead: disparity f B / Z = 20 * 0.5 / 10
    left, right, _, _ = rig.project(np.array([0.0, 0.0, 10.0]))
    assert left[0] - right[0] == pytest.approx(1.0)


def test_rig_equals_the_one_that_was_rectified(make):
    """A known rig rectified by OpenCV; its R1, R2, P2 must recover that rig."""
    rotation = cv2.Rodrigues(np.array([0.02, -0.05, 0.01]))[0]
    t = np.array([[-0.48], [0.03], [0.05]])
    k = [np.array([[f, 0, 500.0], [0, f + 3, 380], [0, 0, 1]]) for f in (1500.0, 1490.0)]
    d = [np.array([0.1, -0.05, 0.001, 0.002, 0.01]), np.array([-0.1, 0.02, 0, 0, 0])]
    r1, r2, p1, p2 = cv2.stereoRectify(k[0], d[0], k[1], d[1], (1024, 768), rotation, t)[:4]
    size = {'width': 1024, 'height': 768}
    infos = [make.info(0, side, k=k[i].reshape(-1), d=d[i], r=r.reshape(-1), p=p.reshape(-1),
                       **size)
             for i, (side, r, p) in enumerate((('left', r1, p1), ('right', r2, p2)))]
    rig = rig_from_info(*infos, 'bag')
    np.testing.assert_allclose(rig.R, rotation, atol=1e-9)
    np.testing.assert_allclose(rig.t, t[:, 0], atol=1e-9)
    np.testing.assert_array_equal(rig.left.K, k[0])
    np.testing.assert_array_equal(rig.right.D, d[1])


@pytest.mark.parametrize(('model', 'count'), [
    ('plumb_bob', 0), ('plumb_bob', 4), ('plumb_bob', 5), ('rational_polynomial', 8),
    ('rational_polynomial', 14), ('equidistant', 4)])
def test_models(make, model, count):
    d = np.full(count, 0.01)
    camera = camera_from_info(make.info(0, 'left', distortion_model=model, d=d), 'left', 'bag')
    assert camera.model == model
    np.testing.assert_array_equal(camera.D[:count], d)


K = [20.0, 0, 7.5, 0, 20, 5.5, 0, 0, 1]


def changed(values, index, value):
    out = np.array(values, dtype=float)
    out[index] = value
    return out


@pytest.mark.parametrize(('side', 'change', 'told'), [
    ('left', {'k': np.zeros(9)}, r'left: CameraInfo K: found focal lengths 0 and 0 px \(not'),
    ('right', {'k': np.zeros(9)}, 'right: CameraInfo K: found focal lengths 0'),
    ('left', {'k': changed(K, 4, 0)}, 'left: CameraInfo K: found focal lengths 20 and 0'),
    ('left', {'k': changed(K, 0, -20)}, 'left: CameraInfo K: found'),
    ('left', {'k': changed(K, 0, np.nan)}, 'left: CameraInfo K: .*wanted finite numbers'),
    ('right', {'d': changed(np.zeros(5), 1, np.inf)}, 'right: CameraInfo D: .*wanted finite'),
    ('right', {'r': changed(np.eye(3).reshape(-1), 0, np.nan)}, 'right: CameraInfo R: .*finite'),
    ('right', {'p': np.full(12, np.nan)}, 'right: CameraInfo P: .*wanted finite'),
    ('left', {'d': np.zeros(3)}, 'left: CameraInfo D: found 3 coefficients, wanted 0 or 4 or 5'),
    ('left', {'distortion_model': 'fov'}, "distortion_model: found 'fov', wanted one of"),
    ('left', {'width': 0}, 'left: CameraInfo size: found 0x12'),
    ('left', {'p': changed([20.0, 0, 7.5, 0, 0, 20, 5.5, 0, 0, 0, 1, 0], 3, -10.0)},
     r'left: CameraInfo P\[3\]: found -10.0, wanted 0'),  # the second of three cameras
    ('left', {'p': changed([20.0, 0, 7.5, 0, 0, 20, 5.5, 0, 0, 0, 1, 0], 7, 1.0)},
     r'left: CameraInfo P\[7\]: found 1.0, wanted 0'),
    ('left', {'r': np.zeros(9)}, 'left: CameraInfo R: found .*wanted a rotation matrix'),
    ('left', {'r': -np.eye(3).reshape(-1)}, 'left: CameraInfo R: '),
    ('right', {'p': np.zeros(12)}, r'right: CameraInfo P\[0\]: found 0.0, wanted a focal'),
    ('right', {'p': [20, 0, 7.5, 0, 0, 20, 5.5, 0, 0, 0, 1, 0]},
     r'right: baseline -P\[3\]/P\[0\]: found 0 m, wanted > 0 m'),
    ('right', {'p': [20, 0, 7.5, 10, 0, 20, 5.5, 0, 0, 0, 1, 0]},
     r'found -0.5 m, wanted > 0 m \(are left and right swapped\?\)'),
    ('right', {'p': [20, 0, 7.5, -10, 0, 20, 5.5, -9, 0, 0, 1, 0]}, r'P\[7\]: found -9.0'),
])
def test_unusable_calibrations_are_refused(make, side, change, told):
    change = {k: np.array(v, float) if isinstance(v, list) else v for k, v in change.items()}
    infos = {s: make.info(0, s, **(change if s == side else {})) for s in ('left', 'right')}
    with pytest.raises(CalibrationError, match='^a.mcap: .*' + told) as caught:
        rig_from_info(infos['left'], infos['right'], 'a.mcap')
    assert '\n' not in str(caught.value)


def test_printed_rotation_is_made_exact(make):
    rotation = cv2.Rodrigues(np.array([0.1, 0.2, -0.1]))[0]
    info = make.info(0, 'right', r=rotation.round(5).reshape(-1))
    rig = rig_from_info(make.info(0, 'left'), info, 'bag')
    np.testing.assert_allclose(rig.R @ rig.R.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(rig.R, rotation.T, atol=1e-5)


def test_image_size_against_calibration(make):
    camera = camera_from_info(make.info(0, 'left'), 'left', 'bag')
    check_image_size(camera, np.zeros((12, 16)), 'bag')
    with pytest.raises(CalibrationError, match='bag: image size: found 12x16 px, wanted 16x12'):
        check_image_size(camera, np.zeros((16, 12)), 'bag')


def test_same_calibration(make):
    first = make.info(0, 'left')
    assert same_calibration(first, make.info(9, 'left'))
    assert not same_calibration(first, make.info(0, 'right'))
    assert not same_calibration(first, make.info(0, 'left', d=np.full(5, 0.1)))
    assert not same_calibration(first, make.info(0, 'left', width=17))
