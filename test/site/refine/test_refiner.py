# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Sites refined from simulated images, against the exact lines."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.core.errors import SiteError
from stereo_speed.core.records import StereoPair
from stereo_speed.geometry.rig import StereoRig
from stereo_speed.lab.sim.config import circle_config, DISTORTED, RoadConfig, straight_config
from stereo_speed.road.problem import RoadPrior
from stereo_speed.road.solving import reshaped
from stereo_speed.site.extras import as_calibrated, DashPeriod, KnownLength, LinesApart
from stereo_speed.site.file import LaneSpec, load_site, PickedLine
from stereo_speed.site.lane_paths import fit_lines, lane_paths
from stereo_speed.site.refine import refiner
from stereo_speed.site.refine.config import RefineConfig
from stereo_speed.site.refine.known_lengths import check_lengths
from stereo_speed.site.refine.picture import picture
from stereo_speed.site.refine.refiner import refine_site
from stereo_speed.site.refine.report import report, summary, summary_lines
from stereo_speed.site.refine.speed_effect import Setup, speed_error
from stereo_speed.site.write import site_text

SMALL = {'width_px': 720, 'height_px': 540, 'f_px': 1250.0}
PAN_DEG = 0.02


def shaded(pair, number):
    """Draw a pole in front of the road and a lasting shadow across it."""
    left, right = pair.left.copy(), pair.right.copy()
    for image in (left, right):
        image[230:260] = (image[230:260] * 0.6).astype(np.uint8)
        image[100:420, 330:342] = 40
    return replace(pair, left=left, right=right)


@pytest.fixture(scope='module')
def drifted(make_scene):
    """Return a straight road seen by a panned rig, with pole and shadow, and its refined site."""
    config = straight_config(rig_moved_deg=(PAN_DEG, 0.0, 0.0), pairs=7,
                             rig=replace(straight_config().rig, **SMALL))
    scene = make_scene(config, 4)
    pairs = [shaded(pair, i) for i, pair in enumerate(scene.sequence.pairs)]
    lengths = (KnownLength('lane', 3.7, 0.005, LinesApart(('line_0', 'edge_right'))),
               KnownLength('dashes', 9.0, 0.02, DashPeriod('line_0')),
               KnownLength('wrong', 3.6, 0.005, LinesApart(('line_0', 'edge_left'))))
    site = replace(scene.site, known_lengths=lengths)
    return scene, refine_site(site, scene.sequence.rig, pairs)


@pytest.fixture(scope='module')
def circle(make_scene):
    """Return a bend that climbs, seen by a distorted rig that is not parallel, and its site."""
    curve = RoadConfig(curvature_start=1 / 41, curvature_end=1 / 41, grade=0.02)
    scene = make_scene(circle_config(road=curve, rig=replace(
        DISTORTED, **{**SMALL, 'right_f_px': 1240.0})), 5)
    return scene, refine_site(scene.site, scene.sequence.rig, scene.sequence.pairs)


@pytest.mark.slow
def test_points_lie_on_the_markings(drifted, circle):
    """To a few hundredths of a pixel, and within the claimed 1-sigma."""
    for scene, refined in (drifted, circle):
        assert refined.lost == ()
        for name, views in refined.found.items():
            for right, line in enumerate(views):
                off = scene.off_px(name, line.uv_px, bool(right))
                assert np.sqrt(np.mean(off**2)) < 0.05, (name, right)
                assert np.sqrt(np.mean((off / line.std_px)**2)) < 1.5
                assert line.shape.kind == 'band'
                assert line.shape.width_m == pytest.approx(0.15, abs=0.02)


@pytest.mark.slow
def test_pan_is_found_and_corrected(drifted):
    """A pan of 0.02 degrees costs 3 %; corrected, less than 0.1 %."""
    scene, refined = drifted
    assert refined.drift.moved_probability > 0.99
    pan, tilt, roll = np.degrees(refined.drift.drift_rad)
    assert pan == pytest.approx(PAN_DEG, abs=0.0012) and tilt == roll == 0
    lane, exact = refined.lanes['lane_0'], scene.exact['lane_0']
    seen = scene.sequence.scene.seen_rig
    error = speed_error(Setup(exact.path, seen), Setup(lane.path, refined.rig))
    assert abs(error) < 0.001 and abs(error) < 3 * lane.scale_std
    rough = lane_paths(scene.site, scene.sequence.rig)['lane_0']
    assert abs(speed_error(Setup(exact.path, seen), Setup(rough.path, scene.sequence.rig))) > 0.02
    text = '\n'.join(summary_lines(refined, report(refined)))
    assert 'pan +0.0' in text and 'calibrate the rig again' in text


@pytest.mark.slow
def test_bend_is_exact(circle):
    scene, refined = circle
    assert not refined.drift.moved
    lane, exact = refined.lanes['lane_0'], scene.exact['lane_0']
    error = speed_error(Setup(exact.path, scene.sequence.rig), Setup(lane.path, refined.rig))
    assert abs(error) < 5e-4
    # Where the lane was clicked, a step in from its ends.
    here = lane.path.position(np.linspace(3, lane.path.length_m - 3, 20))
    off = here - exact.path.position(exact.path.arc_length(here))
    assert np.linalg.norm(off, axis=-1).max() < 0.02
    assert refined.road.problem.model.shape.curvature >= 1


@pytest.mark.slow
def test_known_lengths(drifted):
    """True lengths agree within their 1-sigma; the wrong one is reported."""
    _, refined = drifted
    lane, dashes, wrong = check_lengths(refined)
    assert not lane.wrong and lane.measured_m == pytest.approx(3.7, abs=0.01)
    assert not dashes.wrong and dashes.measured_m == pytest.approx(9.0, abs=0.05)
    assert wrong.wrong
    warned = [w for w in report(refined).warnings if 'sigmas apart' in w]
    assert len(warned) == 1 and 'm, known 3.6 m' in warned[0]


@pytest.mark.slow
def test_file_is_complete(drifted, tmp_path):
    """Written and read again, the site gives the same lanes, with the corrected rig only."""
    scene, refined = drifted
    path = tmp_path / 'refined.yaml'
    path.write_text(site_text(refined.site))
    site, rig = load_site(path), scene.sequence.rig
    with pytest.raises(SiteError, match='rig_correction: found a rig without it'):
        lane_paths(site, rig)
    now = site.corrected_rig(rig)
    assert site.corrected_rig(now) is now and site.fits(now)
    lanes = lane_paths(site, now)
    for name, lane in lanes.items():
        wanted = refined.lanes[name]
        np.testing.assert_allclose(lane.path.position(20.0), wanted.path.position(20.0), atol=1e-3)
        assert lane.scale_std == pytest.approx(wanted.scale_std, rel=1e-3)
        # as far as was clicked
        rough = lane_paths(scene.site, rig)[name]
        assert lane.path.length_m > 0.9 * rough.path.length_m
    assert len(site.known_lengths) == 3


@pytest.mark.slow
def test_plots_are_written(drifted):
    _, refined = drifted
    for right in (False, True):
        drawn = picture(refined, right)
        assert drawn.shape == (1080, 1440, 3)
        assert (drawn.max(axis=-1) > drawn.min(axis=-1) + 80).sum() > 1000  # colours


@pytest.mark.slow
def test_nothing_is_found_on_a_bare_road(drawn):
    """Lines clicked on bare road keep their clicks, and that is reported."""
    rng, shape = np.random.default_rng(0), drawn.image(0).shape
    pairs = [StereoPair(i, i, i, *(rng.normal(90, 2, (2, *shape)).astype(np.uint8)))
             for i in range(3)]
    refined = refine_site(drawn.site, drawn.rig, pairs)
    assert set(refined.lost) == set(drawn.lines) and refined.found == {}
    np.testing.assert_array_equal(refined.site.lines['left'].left_px,
                                  drawn.lines['left'].left_px)
    assert sum('line kept as clicked' in w for w in report(refined).warnings) == 2


@pytest.mark.slow
def test_rough_clicks_on_a_drawn_road_are_refined(drawn):
    """Clicks with a scatter of a pixel become points with one of hundredths, in their order."""
    rng = np.random.default_rng(1)
    lines = {name: PickedLine(name, *(uv + rng.normal(0, 1.0, uv.shape) for uv in line.views_px))
             for name, line in drawn.lines.items()}
    lines['left'] = lines['left'].in_reverse()
    site = replace(drawn.site, lines=lines, lanes=(LaneSpec('a', None, None, 'right', 25.0),
                                                   LaneSpec('b', None, None, 'left', 25.0)))
    images = [np.rint(drawn.image(right)).astype(np.uint8) for right in (0, 1)]
    refined = refine_site(site, drawn.rig, [StereoPair(0, 0, 0, *images)])
    assert refined.lost == () and not refined.drift.moved
    for name, line in refined.site.picked.items():
        for right in (0, 1):
            found = line.views_std_px[right] < 0.5  # except the extrapolated ends
            off = drawn.off_px(name, line.views_px[right][found], right)
            assert np.sqrt(np.mean(off**2)) < 0.02 and found.sum() > 10
    directions = [refined.lanes[n].path.tangent(5.0) @ [0, 0, -1] for n in ('a', 'b')]
    np.testing.assert_allclose(directions, [1, -1], atol=1e-3)


@pytest.mark.slow
def test_camera_that_rotated_too_far_is_refused(drawn):
    """By half a degree of tilt, in images whose road shows it."""
    rng = np.random.default_rng(2)
    texture = rng.normal(0, 12, (12, 360, 640)).mean(axis=0) * 4
    images = [np.clip(drawn.image(right) + texture, 0, 255).astype(np.uint8) for right in (0, 1)]
    moved = drawn.rig.drifted(np.radians([0.0, 0.1, 0.0]))
    calibrated = StereoRig(moved.left, moved.right, moved.R, moved.t)
    with pytest.raises(SiteError, match='tilt of the right camera since its calibration: found'):
        refine_site(drawn.site, calibrated, [StereoPair(0, 0, 0, *images)],
                    RefineConfig(most_drift_deg=0.05))


@pytest.mark.slow
def test_doubtful_drift_is_a_warning_beside_the_results(circle):
    _, refined = circle
    for probability, words in ((0.15, 0), (0.4, 1)):
        doubtful = replace(refined, drift=replace(refined.drift, moved_probability=probability))
        figures = report(doubtful)
        assert sum('may have moved' in w for w in figures.warnings) == words
        assert summary(doubtful, figures)['moved_probability'] == probability
    reported_std = summary(doubtful, figures)['turn_std_deg']
    left = np.degrees(refined.drift.std_rad)
    np.testing.assert_allclose(list(reported_std.values()), left, atol=1e-5)


@pytest.mark.slow
def test_unrefined_site_is_as_certain_as_a_calibration(circle):
    scene, _ = circle
    rig = scene.sequence.rig
    plain = lane_paths(scene.site, rig)
    said = lane_paths(replace(scene.site, correction=as_calibrated()), rig)
    for name, lane in plain.items():
        assert lane.scale_std == pytest.approx(said[name].scale_std) and lane.scale_std > 1e-5


@pytest.mark.slow
def test_turn_does_not_rest_on_a_fit_beside_the_best_road(make_scene, monkeypatch):
    """With an arc in place of a bend of changing curvature the camera seems to have turned."""
    def stuck(site, rig, names, drift=None, prior=RoadPrior(), near=None):
        fit = fit_lines(site, rig, names, drift, prior, near)
        if near is None:
            anew.append(fit)
            return fit
        return reshaped(fit, fit.problem.model.shape._replace(curvature=1))

    anew = []
    scene = make_scene(circle_config(road=RoadConfig(
        curvature_start=1 / 70, curvature_end=1 / 45, grade=0.03), rig=replace(
        straight_config().rig, **SMALL)), 6)
    monkeypatch.setattr(refiner, 'fit_lines', stuck)
    refined = refine_site(scene.site, scene.sequence.rig, scene.sequence.pairs)
    assert len(anew) == 1 and not refined.drift.moved
    monkeypatch.setattr(refiner, '_fitted_anew', lambda *_: [])
    assert refine_site(scene.site, scene.sequence.rig, scene.sequence.pairs).drift.moved


@pytest.mark.slow
def test_clicks_that_contradict_the_found_lines_are_kept(drawn):
    """Both are certain, but the clicks show a road that climbs by 0.4 degrees."""
    images = [np.clip(drawn.image(right, noise=1.0, seed=right), 0, 255).astype(np.uint8)
              for right in (0, 1)]
    depth_m = np.linspace(45.0, 12.0, 12)
    lines = {n: PickedLine(n, *drawn.rig.project(np.column_stack([
        np.full(12, x_m), 3.0 - 0.0076 * (depth_m - 12.0), depth_m]))[:2])
        for n, x_m in (('right', -2.0), ('left', 1.5))}
    site, pairs = replace(drawn.site, lines=lines), [StereoPair(0, 0, 0, *images)]
    kept = refine_site(site, drawn.rig, pairs)
    assert 'combined sigmas' in kept.kept_clicks and not kept.is_found
    np.testing.assert_allclose(kept.site.picked['right'].right_px, lines['right'].right_px)
    # Which of them are wrong is unknown, so speeds by clicks are as uncertain as they differ.
    std = kept.site.lanes[0].path_std
    assert f'differ by {100 * std:+.2f} %' in kept.kept_clicks.replace('-', '+')
    assert kept.lanes['lane'].shape_std >= std > 0.005
    assert refine_site(kept.site, drawn.rig, pairs).site.lanes[0].path_std == pytest.approx(std)
    assert refine_site(kept.site, drawn.rig, pairs, RefineConfig(
        disagreement_sigmas=100.0)).site.lanes[0].path_std == 0.0
    for limit in ({'disagreement_sigmas': 100.0}, {'disagreement_factor': 100.0}):
        refined = refine_site(site, drawn.rig, pairs, RefineConfig(**limit))
        assert not refined.kept_clicks and refined.is_found
        off = drawn.off_px('right', refined.site.picked['right'].right_px, 1)
        assert np.abs(off).mean() < 0.1
