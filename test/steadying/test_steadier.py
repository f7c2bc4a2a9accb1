# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Both cameras together: sway of the rig, drift of the right one, and unknown rotations."""
from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from stereo_speed.core.records import RigMotion
from stereo_speed.steadying.config import SteadyingConfig
from stereo_speed.steadying.report import steadiness_lines, warning
from stereo_speed.steadying.steadier import Reference, rest_of, Steadier

from .conftest import F_PX

CONFIG = SteadyingConfig()
TURN = (float(np.radians(0.03)), 0.0, 0.0)


def off_px(found, true):
    """Return the difference of two motions in px, for sway and drift, without roll."""
    found, true = found or RigMotion(), true or RigMotion()
    return F_PX * np.abs([np.subtract(found.sway_rad, true.sway_rad)[:2],
                          np.subtract(found.drift_rad, true.drift_rad)[:2]]).max(axis=1)


def at_rest_in(rig, pair):
    """Return a steadier of a rig that stands in the site as in a pair."""
    return Steadier(rig, CONFIG, Reference(pair, np.zeros(3), np.zeros((3, 3))))


def dark(pair):
    """Return a pair in whose images nothing is visible."""
    return replace(pair, left=np.zeros_like(pair.left), right=np.zeros_like(pair.right))


def swaying(seed, drift=(0.0, 0.0, 0.0)):
    """Return the motion of a rig that sways by a tenth of a degree."""
    sway = np.radians(0.1) * np.random.default_rng(seed).standard_normal(3)
    return RigMotion(tuple(float(a) for a in sway), drift)


@pytest.mark.slow
def test_fixed_rig_is_unchanged(rig, take):
    steadier = Steadier(rig, CONFIG)
    for k in range(8):
        pair = take(k)
        assert steadier.steady(pair) is pair
    assert steadiness_lines(steadier.state()) == [] and warning(steadier) == ''


def test_state_is_available_before_the_first_pair_and_after_a_time_jump(rig, take):
    steadier = Steadier(rig, CONFIG)
    assert steadier.state().pairs == 0 and not any(steadier.state().rest_deg)
    steadier.steady(take(0))
    steadier.reset()
    assert steadier.state().pairs == 0 and warning(steadier) == ''


@pytest.mark.slow
def test_sway_is_found_in_each_pair_and_reported(rig, take):
    steadier = at_rest_in(rig, take(0))
    steadier.steady(take(0))
    for k in range(1, 8):
        sway, drift = off_px(steadier.steady(take(k, swaying(k))).motion, swaying(k))
        assert sway < 0.02 and drift == 0
    state = steadier.state()
    assert state.swayed == 7 and 0.03 < state.sway_rms_deg[0] < 0.3
    assert steadiness_lines(state)[0].startswith('the rig swayed in 7 of 8 examined pairs')
    assert len(steadiness_lines(state)) == 1


@pytest.mark.slow
def test_rotation_of_the_right_camera_is_no_sway(rig, take):
    steadier = at_rest_in(rig, take(0))
    steadier.steady(take(0))
    for k in range(1, 6):
        true = swaying(k, TURN if k >= 3 else (0.0, 0.0, 0.0))
        sway, drift = off_px(steadier.steady(take(k, true)).motion, true)
        assert sway < 0.02 and drift < 0.05
        assert (warning(steadier) != '') == (k >= 3)
    assert steadier.state().turns == 1


def test_rotation_of_the_left_camera_is_sway_with_opposite_right_drift(rig, take):
    # The right camera is fixed in the world: its drift cancels the sway.
    pan = float(np.radians(0.03))
    back = rig.R[np.ix_([1, 0, 2], [1, 0, 2])] @ np.array([-pan, 0.0, 0.0])
    true = RigMotion((pan, 0.0, 0.0), tuple(float(a) for a in back))
    steadier = at_rest_in(rig, take(0))
    pairs = [take(0), *(take(k, true) for k in range(1, 4))]
    found = [steadier.steady(pair).motion for pair in pairs][-1]
    assert off_px(found, true).max() < 0.05


def test_one_view_alone_shows_the_sway(rig, take):
    steadier = at_rest_in(rig, take(0))
    steadier.steady(take(0))
    one_dark = replace(take(1, swaying(1)), right=np.zeros_like(take(1).right))
    assert off_px(steadier.steady(one_dark).motion, swaying(1))[0] < 0.03
    assert not steadier.lost


@pytest.mark.slow
def test_cameras_at_rest_are_checked_from_time_to_time(rig, take):
    steadier = Steadier(rig, CONFIG)
    for k in range(12):  # at 10 a second: the first five, and one half a second later
        pair = take(k)
        assert steadier.steady(pair) is pair
    assert (steadier.state().pairs, steadier.state().looks) == (12, 5 + 1)


@pytest.mark.slow
def test_onset_of_sway_is_noticed_within_the_interval_and_followed(rig, take):
    steadier = Steadier(rig, CONFIG)
    for k in range(6):
        steadier.steady(take(k))
    found = [steadier.steady(take(k, swaying(k))).motion for k in range(6, 14)]
    seen = next(n for n, motion in enumerate(found) if motion is not None)
    assert seen <= 4  # half a second after the last look
    for k, motion in enumerate(found[seen:], 6 + seen):
        assert off_px(motion, swaying(k))[0] < 0.03
    assert not steadier.settling and not steadier.standing_covariance_rad2.any()


@pytest.mark.slow
def test_rest_of_a_rig_that_sways_at_once_is_learnt(rig, take):
    steadier, poses = Steadier(rig, CONFIG), []
    for k in range(34):
        motion = swaying(100 + k)
        pair = take(100 + k, motion)
        found = steadier.steady(pair).motion
        poses.append(motion.sway_rad)
        # Two sways show it, and three seconds of ten pairs each suffice.
        assert steadier.settling == (2 <= k < 30)
        assert steadier.unsettled_ns == (None if k < 2 else take(100 + min(k, 29)).stamp_ns)
        assert ('rest' in warning(steadier)) == steadier.settling
    mean = np.mean(poses, axis=0)
    assert off_px(found, RigMotion(tuple(motion.sway_rad - mean)))[0] < 0.03
    tilt, pan, roll = np.sqrt(np.diag(steadier.standing_covariance_rad2))  # of a rotation vector
    wanted = np.std(poses, axis=0) / np.sqrt(34)
    assert np.all([pan, tilt, roll] > 0.8 * wanted) and np.all([pan, tilt, roll] < 2 * wanted)
    assert '--refine-site' in steadiness_lines(steadier.state())[1]
    steadier.reset()
    assert steadier.unsettled_ns is None and not steadier.standing_covariance_rad2.any()


def test_one_sway_by_chance_is_no_swaying_rig(rig, take):
    steadier = Steadier(rig, CONFIG)
    for k in range(6):
        steadier.steady(take(k, swaying(k) if k == 2 else None))
    assert steadier.standing_is_fixed and not steadier.standing[0].any()
    assert steadier.unsettled_ns is None


def test_rest_is_learnt_from_the_first_pair_with_details(rig, take):
    motions = {k: swaying(k) for k in range(1, 6)}
    pairs = [take(k, motion) for k, motion in motions.items()]
    steadier = Steadier(rig, replace(CONFIG, look_interval_s=0.0))
    reference = rest_of(steadier, [dark(take(0)), *pairs])
    assert reference.pair is pairs[0]
    steadier = Steadier(rig, CONFIG, reference)
    rest = np.mean([m.sway_rad for m in motions.values()], axis=0)
    wanted = RigMotion(tuple(np.subtract(motions[3].sway_rad, rest)))
    assert off_px(steadier.steady(pairs[2]).motion, wanted)[0] < 0.03
    assert rest_of(Steadier(rig, CONFIG), []) is None


def test_dark_pairs_cost_one_look_in_half_a_second(rig, take):
    """A reference that shows nothing is replaced, which costs more than a look."""
    steadier, learnt = Steadier(rig, CONFIG), []
    for k in range(20):  # ten a second
        pair = dark(take(k))
        assert steadier.steady(pair) is pair and not steadier.lost
        learnt.append(steadier.learnt.pair.stamp_ns)
    assert len(set(learnt)) == 4
    for k in range(20, 27):
        steadier.steady(take(k, swaying(k)))
    assert steadier.state().swayed >= 2


def test_rig_whose_details_moved_and_are_gone_is_not_lost_for_good(rig, take):
    """As when only a vehicle was seen in the dark."""
    steadier = Steadier(rig, replace(CONFIG, renew_pairs=6))
    for k in range(4):
        steadier.steady(take(k, swaying(k)))
    lost = []
    for k in range(4, 24):
        steadier.steady(dark(take(k)))
        lost.append(steadier.lost)
    assert lost[0] and not lost[-1]


def test_reference_read_again_tells_no_drift(rig, take):
    """``replay`` reads the bag twice."""
    def drift_std(first):
        steadier = at_rest_in(rig, take(0))
        for pair in (first, take(1), take(2), take(3)):
            steadier.steady(pair)
        return np.sqrt(np.diag(steadier.drift.covariance_rad2))
    again = replace(take(0), left=take(0).left.copy())
    np.testing.assert_array_equal(drift_std(again), drift_std(take(0)))


def test_warnings_name_what_stops_measuring_first(rig, take):
    steadier = Steadier(rig, CONFIG)
    for k in range(8):
        steadier.steady(take(k, swaying(k, TURN if k > 3 else (0.0, 0.0, 0.0))))
    assert steadier.drift.turned and 'nothing is measured' in warning(steadier)


def test_rest_counts_all_pairs_of_a_rig_that_begins_to_sway(rig, take):
    motions = [*[None] * 6, *(swaying(k) for k in range(6, 12))]
    reference = rest_of(Steadier(rig, replace(CONFIG, look_interval_s=0.0)),
                        [take(k, motion) for k, motion in enumerate(motions)])
    mean = np.sum([m.sway_rad for m in motions if m], axis=0) / 12
    assert reference.rest_rad == pytest.approx(mean, abs=2e-5)


@pytest.mark.slow
def test_camera_rotated_between_looks_is_found_by_the_next_look(rig, take):
    steadier = Steadier(rig, CONFIG)
    for k in range(6):
        steadier.steady(take(k))
    still = RigMotion((0.0, 0.0, 0.0), TURN)
    for k in range(6, 12):
        pair = steadier.steady(take(k, still))
    assert off_px(pair.motion, still).max() < 0.05 and steadier.state().turns == 1


def test_driving_rig_is_not_taken_for_swaying(rig, take):
    steadier = Steadier(rig, CONFIG)
    for k in range(6):
        nearer = np.array([[1 + 0.02 * k, 0.0, -5.0 * k], [0.0, 1 + 0.02 * k, -4.0 * k]])
        pair = take(k)
        pair = replace(pair, left=cv2.warpAffine(pair.left, nearer, pair.left.shape[::-1]),
                       right=cv2.warpAffine(pair.right, nearer, pair.right.shape[::-1]))
        assert steadier.steady(pair) is pair and not steadier.lost
    assert steadier.state().unknown == steadier.state().looks - 1 >= 4


def test_blank_pair_is_unknown_and_the_next_is_found(rig, take):
    steadier = at_rest_in(rig, take(0))
    for k in range(3):
        steadier.steady(take(k, swaying(k) if k else None))
    steadier.steady(dark(take(3)))
    assert steadier.lost and steadier.state().unknown == 1
    assert off_px(steadier.steady(take(4, swaying(4))).motion, swaying(4))[0] < 0.03
    assert not steadier.lost


def test_changed_scene_is_learnt_anew(rig, take):
    steadier = Steadier(rig, replace(CONFIG, renew_pairs=2))
    steadier.steady(take(0))
    mirrored = [replace(pair, left=pair.left[:, ::-1].copy(), right=pair.right[:, ::-1].copy())
                for pair in map(take, range(1, 6))]
    for pair in mirrored:
        steadier.steady(pair)
    assert steadier.state().unknown == 2 and not steadier.lost


@pytest.mark.slow
def test_earlier_rotation_is_kept_when_the_scene_is_learnt_anew(rig, take):
    steadier = Steadier(rig, replace(CONFIG, renew_pairs=2))
    steadier.steady(take(0))
    for k in range(1, 4):
        steadier.steady(take(k, swaying(k, TURN)))
    found = steadier.drift.corrected_rad
    still = RigMotion((0.0, 0.0, 0.0), TURN)
    for k in range(4, 8):  # from the third of them on, against the third of them
        pair = take(k, still)
        steadier.steady(replace(pair, left=pair.left[:, ::-1].copy(),
                                right=pair.right[:, ::-1].copy()))
    assert steadier.state().unknown == 2 and not steadier.lost
    assert F_PX * np.abs(steadier.drift.corrected_rad - found)[:2].max() < 0.05
    assert steadier.state().turns == 1 and warning(steadier) != ''


def test_drift_uncertainty_grows_with_all_pairs_since_the_last_look(rig, take):
    def pairs_counted(unseen):
        steadier = Steadier(rig, replace(CONFIG, still_looks=10))
        black = np.zeros_like(take(0).right)
        steadier.steady(take(0))
        for k in range(1, 5):
            steadier.steady(replace(take(k), right=black) if unseen else take(k))
        counted: list[int] = []
        update = steadier.drift.update
        steadier.drift.update = lambda *args: (counted.append(args[-1]), update(*args))
        steadier.steady(take(5))
        return counted
    assert pairs_counted(False) == [1] and pairs_counted(True) == [5]


def test_reset_forgets_everything_but_the_reference(rig, take):
    steadier = Steadier(rig, CONFIG)
    for k in range(3):
        steadier.steady(take(k, swaying(k, TURN) if k else None))
    steadier.reset()
    assert steadier.state().pairs == 0 and not steadier.drift.turned
    assert steadier.steady(take(5, swaying(5))).motion is None  # the first is the reference again


def test_rest_is_the_mean_of_the_sway(rig, take):
    motions = [swaying(k) for k in range(6)]
    pairs = [take(k, motion) for k, motion in enumerate(motions)]
    reference = rest_of(Steadier(rig, CONFIG), pairs)
    steadier = Steadier(rig, CONFIG, reference)
    rest = np.mean([m.sway_rad for m in motions], axis=0)
    for pair, motion in zip(pairs, motions):
        wanted = RigMotion(tuple(np.subtract(motion.sway_rad, rest)))
        assert off_px(steadier.steady(pair).motion, wanted)[0] < 0.03


@pytest.mark.slow
@pytest.mark.parametrize('name, value, pairs', [
    ('details', 60, 3), ('least_details', 2000, 3), ('least_ncc', 0.999, 3),
    ('outlier_sigmas', 0.5, 3), ('detail_floor_px', 0.5, 3), ('independent_details', 3.0, 3),
    ('most_spread_px', 0.01, 3), ('look_interval_s', 0.0, 9), ('still_looks', 100, 9),
    ('sway_std_deg', 0.001, 3), ('sway_probability', 0.99, 3), ('drift_std_deg', 0.002, 3),
    ('drift_probability', 0.0, 3), ('drift_rate_deg', 0.01, 3), ('drift_floor_deg', 0.02, 3),
    ('drift_sigmas', 100.0, 3), ('learning_share', 0.9, 6), ('renew_pairs', 2, 6)])
def test_every_parameter_changes_something(name, value, pairs, rig, take):
    # Whether so little is sway is open.
    little = RigMotion((float(np.radians(0.002)), 0.0, 0.0))
    motion = ((lambda k: little) if name in ('sway_std_deg', 'sway_probability') else
              (lambda k: None) if name in ('look_interval_s', 'still_looks') else
              (lambda k: swaying(k, TURN)))

    def outcome(config):
        steadier = Steadier(rig, config)
        found = [steadier.steady(take(k, motion(k) if k else None)).motion for k in range(pairs)]
        return found, steadier.state(), steadier.drift.covariance_rad2.tolist()
    base = replace(CONFIG, renew_pairs=3 if name == 'learning_share' else CONFIG.renew_pairs)
    assert outcome(replace(base, **{name: value})) != outcome(base)
