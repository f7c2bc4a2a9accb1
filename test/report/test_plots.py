# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Plots of a run."""
from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from stereo_speed.core.passes import Verdict
from stereo_speed.core.units import MPH_MPS
from stereo_speed.report import overlay, plots


def texts(axes) -> str:
    """Return all labels of a legend, joined."""
    return ' | '.join(axes.get_legend_handles_labels()[1])


def test_same_run_gives_the_same_bytes(tmp_path, updates, passes, lanes):
    contents = []
    for name in ('a', 'b'):
        (tmp_path / name).mkdir()
        files = plots.write_plots(tmp_path / name, updates, passes, lanes)
        assert [f.name for f in files] == ['speed.png', 'road.png']
        contents.append([f.read_bytes() for f in files])
        assert all(cv2.imread(str(f)).shape[1] >= 1000 for f in files)
    assert contents[0] == contents[1]
    assert b'matplotlib' not in b''.join(contents[0])


def test_nothing_tracked(tmp_path, lanes):
    assert all(f.is_file() for f in plots.write_plots(tmp_path, [], [], lanes))


def test_speed_has_live_smoothed_band_and_limit(updates, passes, lanes):
    axes = plots.speed_figure(updates, passes, lanes).axes[0]
    told = texts(axes)
    assert 'vehicle 3, live' in told
    assert '44.74 ± 0.22 mph' in told  # 20 ± 0.1 m/s
    assert 'limit of near, 50 mph' in told
    assert 'truth' not in told
    low, high = axes.get_ylim()
    assert low < 44 < 50 < high
    live = [line for line in axes.lines if 'live' in str(line.get_label())][0]
    assert len(live.get_xdata()) == 6  # the first two are not confirmed
    assert live.get_xdata()[0] == pytest.approx(0.4)
    assert live.get_ydata() == pytest.approx(20.0 / MPH_MPS)
    bands = [c for c in axes.collections if type(c).__name__.startswith(('Fill', 'Poly'))]
    assert len(bands) == 1


def test_truth_is_drawn_if_given(updates, passes, lanes):
    truth = {'car': [(u.stamp_ns, 21.0) for u in updates]}
    axes = plots.speed_figure(updates, passes, lanes, truth).axes[0]
    line = [line for line in axes.lines if line.get_label() == 'truth'][0]
    assert line.get_ydata() == pytest.approx(21.0 / MPH_MPS)
    assert np.ptp(line.get_xdata()) == pytest.approx(1.4)


def test_rejected_pass_shows_its_reason(updates, passes, lanes):
    rejected = replace(passes[0], verdict=Verdict.REJECTED, reason='too_short', speed_mps=None,
                       speed_std_mps=None)
    assert 'rejected (too_short)' in texts(plots.speed_figure(updates, [rejected], lanes).axes[0])


def test_lane_without_a_limit(updates, passes, lanes):
    lanes['near'].speed_limit_mps, kept = None, lanes['near'].speed_limit_mps
    try:
        assert 'limit' not in texts(plots.speed_figure(updates, passes, lanes).axes[0])
    finally:
        lanes['near'].speed_limit_mps = kept


def test_road_shows_places_from_above(updates, lanes):
    axes = plots.road_figure(updates, lanes).axes[0]
    track = [line for line in axes.lines if len(line.get_xdata()) == len(updates)][0]
    assert track.get_xdata() == pytest.approx([u.position_m[2] for u in updates])
    assert track.get_ydata() == pytest.approx([u.position_m[0] for u in updates])
    assert axes.yaxis_inverted()  # right of the camera is down where forward is to the right


def test_colours_match_the_overlay():
    for track in range(8):
        red, green, blue = (int(plots.colour_of(track)[k:k + 2], 16) for k in (1, 3, 5))
        assert overlay.colour_of(track) == (blue, green, red)
