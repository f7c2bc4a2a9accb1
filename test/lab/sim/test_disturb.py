# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Recordings transformed as if the rig swayed, or a camera were displaced or out of focus."""
from __future__ import annotations

import re

import cv2
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime)
from rosbags.rosbag2 import Writer
from rosbags.typesys import get_typestore, Stores
from stereo_speed.cli import main as cli
from stereo_speed.core.errors import InputError
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.io.bags import StereoBag
from stereo_speed.lab.sim import RigConfig, simulate, straight_config
from stereo_speed.lab.sim.calibration_error import drawn_calibration
from stereo_speed.lab.sim.disturb import Disturbance, Disturber, grain_grey
from stereo_speed.lab.sim.disturb_bag import disturb_bag
from stereo_speed.lab.sim.scene import make_rig
from stereo_speed.lab.sim.write import write_bag

SMALL = RigConfig(width_px=320, height_px=240, f_px=560.0)
STAMPS_NS = [10 ** 9 + k * 2 * 10 ** 8 for k in range(40)]
LEFT, RIGHT = 0, 1
FOREVER = QosTime(2147483647, 4294967295)
LATCHED = Qos(QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
              FOREVER, FOREVER, QosLiveliness.AUTOMATIC, FOREVER, False)


def _disturber(grain=(0.0, 0.0), **what):
    return Disturber(Disturbance(**what), make_rig(SMALL), STAMPS_NS, grain,
                     np.random.default_rng(0))


def _waves(shift_px=0.0):
    """Return smooth waves across the columns, shifted to the right."""
    u = np.arange(SMALL.width_px) - shift_px
    return np.tile(120.0 + 80.0 * np.sin(u / 6.0), (SMALL.height_px, 1))


def _grainy(grey, sigma, seed=1):
    noise = np.random.default_rng(seed).normal(0.0, sigma, (SMALL.height_px, SMALL.width_px))
    return np.clip(np.rint(grey + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize('camera', [LEFT, RIGHT])
def test_rotated_camera_moves_distant_points(camera):
    disturber = _disturber(turn_deg=(0.2, 0.0, 0.0), camera=camera)
    image = np.rint(_waves()).astype(np.uint8)
    # By hand: what lay at angle a off the axis is at a - 0.2 degrees after a pan to the right.
    middle = slice(140, 180)  # near the axis the shift is f tan(0.2 degrees) to 0.1 px
    wanted = _waves(-SMALL.f_px * np.tan(np.radians(0.2)))
    turned = disturber.disturbed(image, STAMPS_NS[5], camera)
    assert np.abs(turned - wanted)[100:140, middle].max() < 2.5
    np.testing.assert_array_equal(disturber.disturbed(image, STAMPS_NS[5], 1 - camera), image)


def test_rotation_comes_at_its_time():
    disturber = _disturber(turn_deg=(0.0, 0.5, 0.0), turn_s=2.0)
    assert [k for k in range(40) if disturber.motion(k, RIGHT)] == list(range(10, 40))


def test_sway_is_equal_in_both_views_and_has_its_amplitude():
    disturber = _disturber(sway_deg=0.1)
    sway = np.degrees([disturber.motion(k, LEFT).sway_rad for k in range(40)])
    # The variance of 120 normal values is within 4 of its 1-sigmas, sqrt(2 / 120).
    assert abs(sway.var() / 0.01 - 1) < 4 * np.sqrt(2 / 120)
    assert [disturber.motion(k, RIGHT) for k in range(40)] == [
        disturber.motion(k, LEFT) for k in range(40)]


def test_sway_of_a_mast_is_a_wave_of_its_frequency_in_each_angle():
    disturber = _disturber(sway_deg=0.1, sway_hz=1.0)
    sway = np.degrees([disturber.motion(k, LEFT).sway_rad for k in range(40)])
    times_s = (disturber._stamps_ns[:40] - disturber._stamps_ns[0]) * 1e-9
    waves = np.column_stack([wave(2 * np.pi * times_s) for wave in (np.sin, np.cos)])
    parts, residual, *_ = np.linalg.lstsq(waves, sway, rcond=None)
    assert np.abs(waves @ parts - sway).max() < 1e-9
    np.testing.assert_allclose(np.linalg.norm(parts, axis=0), np.sqrt(2) * 0.1)
    assert np.ptp(np.arctan2(*parts)) > 0.1  # not in step
    assert [disturber.motion(k, RIGHT) for k in range(40)] == [
        disturber.motion(k, LEFT) for k in range(40)]


@pytest.mark.parametrize('what', [{'turn_deg': (0.05, 0.05, 0.0)}, {'defocus_px': 2.0}])
def test_grain_keeps_its_strength(what):
    image = _grainy(120.0, 3.0)
    found = _disturber((0.0, 3.0), **what).disturbed(image, STAMPS_NS[0], RIGHT)
    assert found.std() == pytest.approx(image.std(), rel=0.03)


def test_grain_of_an_image_is_estimated():
    images = [_grainy(_waves(), 2.0, seed) for seed in range(4)]
    for k, image in enumerate(images):
        image[50 * k:50 * k + 50] = 250  # a passing object
    # Whole grey levels add a twelfth to the variance; a 1 in 370 beyond 3 sigmas is left out.
    assert grain_grey(images) == pytest.approx(np.hypot(2.0, 1 / np.sqrt(12)), rel=0.03)
    assert grain_grey(images[:1]) == 0.0


def test_exposure_steps_are_shared_by_the_pair():
    disturber = _disturber(exposure_step=0.15)
    image = np.full((SMALL.height_px, SMALL.width_px), 100, np.uint8)
    image[100:120, 100:120] = 255
    left, right = ([disturber.disturbed(image, ns, side) for ns in STAMPS_NS]
                   for side in (LEFT, RIGHT))
    steps = np.array([one[0, 0] / 100 - 1 for one in left])
    np.testing.assert_array_equal([one[0, 0] for one in right], [one[0, 0] for one in left])
    assert np.all(np.abs(steps) <= 0.151) and steps.min() < -0.1 and steps.max() > 0.1
    assert all(one[110, 110] == 255 for one in left)  # clipped light stays so


@pytest.mark.parametrize('gamma', [1.0, 2.2])
def test_defocused_camera_spreads_the_light_of_edges(gamma):
    step = np.where(np.arange(SMALL.width_px) < 160, 50.0, 200.0)
    image = np.tile(step, (SMALL.height_px, 1)).astype(np.uint8)
    disturber = _disturber(defocus_px=2.0, gamma=gamma)
    row = disturber.disturbed(image, STAMPS_NS[0], RIGHT)[100].astype(float)
    rise = np.diff(row ** gamma) / (200 ** gamma - 50 ** gamma)
    at = np.arange(rise.size) + 0.5
    assert rise @ at == pytest.approx(159.5, abs=0.05)
    assert np.sqrt(rise @ np.square(at - rise @ at)) == pytest.approx(2.0, abs=0.1)
    np.testing.assert_array_equal(disturber.disturbed(image, STAMPS_NS[0], LEFT), image)


def test_defocused_camera_that_sways_sees_black_beside_white():
    """Interpolation goes below black there, which has no root."""
    image = np.zeros((SMALL.height_px, SMALL.width_px), np.uint8)
    image[100:140, 160:] = 255
    disturber = _disturber(defocus_px=1.0, gamma=2.2, sway_deg=0.1)
    seen = disturber.disturbed(image, STAMPS_NS[1], RIGHT)
    far = cv2.erode((image == 0).astype(np.uint8), np.ones((31, 31), np.uint8)) > 0
    assert not seen[far].any() and seen[115:125, 200:300].min() == 255
    assert (seen[:, 250] > 127).sum() > 40  # light spreads beyond the 40 rows of white


def test_sixteen_bit_images_stay_sixteen_bit():
    image = np.full((SMALL.height_px, SMALL.width_px), 30000, np.uint16)
    found = _disturber(exposure_step=0.5).disturbed(image, STAMPS_NS[0], LEFT)
    assert found.dtype == np.uint16 and 15000 <= found[0, 0] <= 45000 and found[0, 0] != 30000


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    """Write three pairs of a small rig, without noise."""
    sequence = simulate(straight_config(rig=SMALL, pairs=3, noise_grey=0.0),
                        np.random.default_rng(3))
    folder = tmp_path_factory.mktemp('recorded')
    for storage, compressed in (('mcap', True), ('sqlite3', False), ('ros1', False)):
        write_bag(sequence, folder / storage, storage, compressed=compressed)
    return folder


def _messages(bag):
    with AnyReader([bag]) as reader:
        return [(c.topic, c.msgtype, t, bytes(data)) for c, t, data in reader.messages()]


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_bag_keeps_everything_but_its_images(recorded, tmp_path, storage):
    what = Disturbance(turn_deg=(0.0, 0.0, 1.0))
    source = recorded / storage / 'bag'
    for name in ('one', 'two'):
        assert disturb_bag(source, tmp_path / name, what, np.random.default_rng(4)).pairs == 3
    before, after, again = (_messages(bag) for bag in (
        source, tmp_path / 'one/bag', tmp_path / 'two/bag'))
    assert after == again
    assert [m[:3] for m in after] == [m[:3] for m in before]
    for one, two in zip(before, after):
        same = slice(None) if 'camera_info' in one[0] else slice(4, 12)  # the stamp of an image
        assert one[3][same] == two[3][same]
    with StereoBag(source) as bag, StereoBag(tmp_path / 'one/bag') as copy:
        for pair, turned in zip(bag.pairs(), copy.pairs()):
            centre = (SMALL.width_px / 2, SMALL.height_px / 2)
            rolled = cv2.warpAffine(pair.right, cv2.getRotationMatrix2D(centre, 1.0, 1.0),
                                    (SMALL.width_px, SMALL.height_px))
            inside = np.s_[30:-30, 30:-30]
            off = [np.abs(turned.right.astype(float) - one)[inside].mean()
                   for one in (rolled, pair.right)]
            assert off[0] < off[1] / 2  # the picture of a camera rolled clockwise turns back
            assert np.abs(turned.left.astype(float) - pair.left).mean() < 1.0
    suffix = {'mcap': 'mcap', 'sqlite3': 'db3'}[storage]
    assert len(list((tmp_path / 'one/bag').glob(f'*.{suffix}'))) == 1


def test_other_calibration_is_the_only_change_of_a_bag(recorded, tmp_path):
    source = recorded / 'mcap/bag'
    for name, seed in (('one', 4), ('again', 4), ('two', 5)):
        disturb_bag(source, tmp_path / name, Disturbance(calibration=True),
                    np.random.default_rng(seed))
    before, after, again = (_messages(bag) for bag in (
        source, tmp_path / 'one/bag', tmp_path / 'again/bag'))
    assert after == again and [m[:3] for m in after] == [m[:3] for m in before]
    assert [one[0].rsplit('/', 1)[1] for one, two in zip(before, after) if one != two] == [
        'camera_info'] * 6
    with StereoBag(source) as bag, StereoBag(tmp_path / 'one/bag') as one, \
            StereoBag(tmp_path / 'two/bag') as two:
        focal = [b.rig.left.K[0, 0] / bag.rig.left.K[0, 0] - 1 for b in (one, two)]
        baseline = [b.rig.baseline_m / bag.rig.baseline_m - 1 for b in (one, two)]
        wanted = drawn_calibration(bag.rig, TrackerConfig(), np.random.default_rng(4).spawn(4)[3])
        for camera, drawn in ((one.rig.left, wanted.left), (one.rig.right, wanted.right)):
            np.testing.assert_allclose(camera.K, drawn.K)
        np.testing.assert_allclose(one.rig.R, wanted.R, atol=1e-12)
        np.testing.assert_allclose(one.rig.t, wanted.t, atol=1e-12)
    assert len({0.0, *focal, *baseline}) == 5


def test_printed_errors_are_those_of_the_calibration(recorded, tmp_path, capsys):
    source = recorded / 'mcap/bag'
    assert cli.main(['disturb', str(source), '--out', str(tmp_path / 'out'), '--calibration']) == 0
    focal, baseline_mm, *angles_deg = map(
        float, re.findall(r'[-+]\d+\.\d+', capsys.readouterr().out.splitlines()[-1]))
    with StereoBag(source) as bag, StereoBag(tmp_path / 'out/bag') as copy:
        true, told = bag.rig, copy.rig
    assert told.right.K[0, 0] / true.right.K[0, 0] == pytest.approx(1 + focal / 100, abs=1e-5)
    assert 1000 * (told.baseline_m - true.baseline_m) == pytest.approx(baseline_mm, abs=0.01)
    np.testing.assert_allclose(true.drifted(np.radians(angles_deg)).R, told.R, atol=2e-6)
    assert np.abs(true.R - told.R).max() > 5e-6


def test_topics_without_a_header_are_kept_with_their_qos(recorded, tmp_path):
    store = get_typestore(Stores.ROS2_JAZZY)
    source = tmp_path / 'with_words'
    with AnyReader([recorded / 'mcap/bag']) as reader, Writer(source, version=9) as writer:
        out = {c.id: writer.add_connection(c.topic, c.msgtype, typestore=store)
               for c in reader.connections}
        words = writer.add_connection('/words', 'std_msgs/msg/Empty', typestore=store,
                                      offered_qos_profiles=[LATCHED])
        empty = store.serialize_cdr(store.types['std_msgs/msg/Empty'](), 'std_msgs/msg/Empty')
        for connection, ns, data in reader.messages():
            writer.write(out[connection.id], ns, data)
            writer.write(words, ns, empty)
    disturb_bag(source, tmp_path / 'out', Disturbance(sway_deg=0.1), np.random.default_rng(0))
    topics = [m[0] for m in _messages(tmp_path / 'out/bag')]
    assert topics == [m[0] for m in _messages(source)] and topics.count('/words') == 12
    with AnyReader([tmp_path / 'out/bag']) as reader:
        assert {c.topic: c.ext.offered_qos_profiles for c in reader.connections}[
            '/words'] == [LATCHED]


@pytest.mark.parametrize('bag, options, told', [
    ('mcap/bag', [], 'disturbance: found none, wanted a sway'),
    ('mcap/bag', ['--turn-deg', '0.1', '--turn-at', '60'], 'found 60 s, wanted at most 0.4 s'),
    ('mcap/bag', ['--sway-deg', '5'], '5 is not in [0, 2]'),
    ('ros1/bag.bag', ['--sway-deg', '0.1'], 'found one of ROS 1'),
    ('nowhere', ['--sway-deg', '0.1'], 'no such file or folder')])
def test_invalid_options_are_refused_in_one_line(recorded, tmp_path, capsys, bag, options, told):
    out = tmp_path / 'out'
    assert cli.main(['disturb', str(recorded / bag), '--out', str(out), *options]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and told in lines[0] and not out.exists()


def test_existing_folder_is_left_alone(recorded, tmp_path):
    (tmp_path / 'mine').write_text('kept')
    with pytest.raises(InputError, match='something there already'):
        disturb_bag(recorded / 'mcap/bag', tmp_path, Disturbance(sway_deg=0.1),
                    np.random.default_rng(0))
    assert [f.name for f in tmp_path.iterdir()] == ['mine']


def test_image_between_pairs_goes_with_the_nearest():
    disturber = _disturber(sway_deg=0.1)
    assert [disturber.nearest(STAMPS_NS[3] + off) for off in (-99_999_999, 0, 99_999_999)] == [
        3, 3, 3]
