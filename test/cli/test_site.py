# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""``site`` end to end on the sample, and bad input."""
from __future__ import annotations

import numpy as np
import pytest
from stereo_speed.cli.main import main
from stereo_speed.cli.site import refined_from_bag
from stereo_speed.lab.sim.disturb import Disturbance
from stereo_speed.lab.sim.disturb_bag import disturb_bag
from stereo_speed.site.file import load_site
import yaml


@pytest.mark.slow
def test_refine_writes_a_usable_site(sample, short_bag, tmp_path, capsys):
    out, pictures = tmp_path / 'new' / 'near.yaml', tmp_path / 'pictures'
    assert main(['site', 'refine', str(short_bag), '--site', str(sample / 'site.yaml'),
                 '--out', str(out), '--pictures', str(pictures)]) == 0
    printed = capsys.readouterr().out
    for word in ('edge_right', 'residual px', 'mph at the speed limit', 'epipolar',
                 'only 4 pairs'):
        assert word in printed
    site, rough = load_site(out), load_site(sample / 'site.yaml')
    assert site.lanes == rough.lanes and list(site.lines) == list(rough.lines)
    assert all(line.left_std_px is not None and np.median(line.left_std_px) < 0.06
               for line in site.lines.values())
    assert not np.any(site.correction.drift_rad)
    # everything needed by a program that reads picked lines
    plain = yaml.safe_load(out.read_text())
    assert plain['stereo_speed_site'] == 1
    assert all(len(p) == 2 for p in plain['lines']['line_0']['right_image'])
    assert sorted(p.name for p in pictures.iterdir()) == ['near_left.png', 'near_right.png']
    assert [p.name for p in out.parent.iterdir()] == ['near.yaml']


@pytest.mark.slow
def test_check_changes_nothing(edited, short_bag, tmp_path, capsys):
    """On a site of one line, because the time grows with the lines."""
    def one_line(data):
        data['lines'] = {'edge_right': data['lines']['edge_right']}
        data['lanes'] = [{'name': 'lane_0', 'path': 'edge_right', 'speed_limit': '55 mph'}]
    site = edited('site.yaml', one_line)
    before = site.read_bytes()
    assert main(['site', 'check', str(short_bag), '--site', str(site)]) == 0
    assert 'lane_0' in capsys.readouterr().out
    assert site.read_bytes() == before and list(tmp_path.iterdir()) == [site]


@pytest.mark.slow
def test_site_of_a_swaying_rig_is_refined_as_if_it_stood_still(sample, short_bag, tmp_path):
    """Swayed by 0.1 degrees the four images differ by some pixels; lines are thinner than that."""
    disturb_bag(short_bag, tmp_path / 'swayed', Disturbance(sway_deg=0.1),
                np.random.default_rng(2))
    still, swayed = (refined_from_bag(load_site(sample / 'site.yaml'), bag)
                     for bag in (short_bag, tmp_path / 'swayed' / 'bag'))
    assert swayed.lost == () and not swayed.kept_clicks
    assert swayed.road.residual_px.max() < 2 * still.road.residual_px.max()


@pytest.mark.parametrize('arguments, message', [
    (['site'], 'ACTION'),
    (['site', 'refine', 'BAG', '--site', 'SITE'], '--out'),
    (['site', 'refine', 'BAG', '--site', 'SITE', '--out', '.'], 'found a folder'),
    (['site', 'check', 'BAG', '--site', 'nowhere.yaml'], 'nowhere.yaml'),
    (['site', 'check', 'nowhere', '--site', 'SITE'], 'nowhere'),
])
def test_refusals(sample, short_bag, capsys, arguments, message):
    named = {'BAG': str(short_bag), 'SITE': str(sample / 'site.yaml')}
    assert main([named.get(a, a) for a in arguments]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count('\n') == 1
