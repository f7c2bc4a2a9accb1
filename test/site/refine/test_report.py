# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The report of a refinement: its figures, and when it warns."""
from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest
from stereo_speed.site.extras import DashPeriod, KnownLength, LinesApart, RigCorrection
from stereo_speed.site.refine import report as report_module
from stereo_speed.site.refine.config import RefineConfig
from stereo_speed.site.refine.report import report, summary, summary_lines


@pytest.fixture(scope='module')
def figures(drawn_refined):
    """Return the report of a drawn road."""
    return report(drawn_refined)


def test_figures_of_lines_and_lanes(drawn_refined, figures):
    """The picks are exact, the lane is 3.5 m wide, about half the line is dashes."""
    right, left = figures.lines
    assert (right.name, right.kind, left.name) == ('right', 'band', 'left')
    assert max(right.residual_px) < 1e-4 and right.width_m == pytest.approx(0.15, abs=0.01)
    assert all(0.1 < share < 0.65 for share in right.painted)
    lane, = figures.lanes
    assert lane.width_m == pytest.approx(3.5) and lane.width_std_m > 0
    assert abs(lane.change) < 1e-6 and lane.std >= drawn_refined.lanes['lane'].scale_std
    assert figures.lengths == () and lane.limit_mps == 25.0


def test_change_is_that_of_the_speeds_from_the_clicks_to_the_refined_site(
        drawn_refined, monkeypatch):
    """Along clicks that make lengths a quarter too long, speeds read a quarter too high."""
    def error(true, used):
        assert true.path is drawn_refined.lanes['lane'].path is not used.path
        return 0.25
    monkeypatch.setattr(report_module, 'speed_error', error)
    lane, = report(drawn_refined).lanes
    assert lane.change == pytest.approx(-0.2)
    assert any('refinement changes speeds by -20.000 %' in line
               for line in summary_lines(drawn_refined, report(drawn_refined)))


@pytest.mark.parametrize(('share', 'warned'), [(0.0, False), (0.1, False), (0.5, True)])
def test_sites_of_roads_that_headlamps_sweep_should_be_refined_by_day(
        drawn_refined, share, warned):
    """Of so much of the near part of the image."""
    views = []
    for view in drawn_refined.views:
        change = np.zeros((180, 320), np.float32)
        change[180 - round(120 * share):] = 0.3
        views.append(replace(view, change=change))
    found = report(replace(drawn_refined, views=tuple(views))).warnings
    assert any('refine the site by day' in text for text in found) == warned


def test_lines_of_text(drawn_refined, figures):
    text = summary_lines(drawn_refined, figures)
    assert text[0].startswith('background of 9 pairs, noise 1.0 and 1.0')
    assert any(line.startswith('right ') and ' band ' in line for line in text)
    assert 'road: straight, plane surface' in text
    assert any(line.startswith('lane: 3.5000 m') for line in text)
    assert [line for line in text if line.startswith('warning: ')] == [
        f'warning: {warning}' for warning in figures.warnings]


def test_plain_values(drawn_refined, figures):
    values = summary(drawn_refined, figures)
    assert list(values) == ['turn_deg', 'turn_std_deg', 'moved_probability', 'residual_px',
                            'path_and_rig_std', 'kept_clicks', 'warnings']
    assert values['turn_deg'] == {'pan': 0.0, 'tilt': 0.0, 'roll': 0.0}
    np.testing.assert_allclose(list(values['turn_std_deg'].values()),
                               np.degrees(drawn_refined.drift.std_rad), atol=1e-5)


def warned(refined, words):
    """Return how many warnings contain the words."""
    return sum(words in warning for warning in report(refined).warnings)


@pytest.mark.parametrize('words, quiet, loud', [
    ('only 9 pairs', {'few_pairs': 9}, {'few_pairs': 10}),
    ('may have moved', {'doubtful_probability': 1.0}, {'doubtful_probability': 0.0}),
    ('1-sigma of speeds by path and rig is', {'worst_speed_std': 1.0}, {'worst_speed_std': 0.0}),
    ('px r.m.s. off the road', {'worst_residual_px': 1.0}, {'worst_residual_px': 0.0})])
def test_each_limit_triggers_its_warning(drawn_refined, words, quiet, loud):
    assert warned(replace(drawn_refined, config=RefineConfig(**quiet)), words) == 0
    assert warned(replace(drawn_refined, config=RefineConfig(**loud)), words) >= 1


def test_other_warnings(drawn, drawn_refined):
    """Drift, drift since the last time, lost lines, and lengths that are wrong or not seen."""
    drift = replace(drawn_refined.drift, drift_rad=np.radians([0.02, 0.0, 0.0]))
    before = RigCorrection(np.zeros(3), np.eye(3) * np.radians(0.0003)**2)
    known = (KnownLength('short', 3.0, 0.01, LinesApart(('right', 'left'))),
             KnownLength('unseen', 3.0, 0.01, DashPeriod('left')))
    refined = replace(drawn_refined, drift=drift, rough=replace(drawn.site, correction=before),
                      site=replace(drawn.site, known_lengths=known),
                      found={'right': drawn_refined.found['right']})
    warnings = '\n'.join(report(refined).warnings)
    for words in ('has moved since the calibration: pan +0.0200°',
                  'since the site was refined: pan', 'left: no marking or kerb found',
                  'short: measured 3.5', 'unseen: cannot be measured'):
        assert words in warnings
    assert 'tilt' not in warnings


def test_lines_that_were_not_found(drawn_refined):
    lost = replace(drawn_refined, found={}, road=None)
    right = report(lost).lines[0]
    assert right.kind == 'as clicked' and right.points == (0, 0) and math.isnan(right.width_m)
    assert lost.lost == ('right', 'left')
    assert 'right          as clicked' in summary_lines(lost, report(lost))
