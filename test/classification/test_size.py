# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Sizes of simulated vehicles, from their pairs and their positions in them."""
from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from stereo_speed.classification.size import HeightSearch, VehicleSize
from stereo_speed.core.passes import VehicleClass
from stereo_speed.core.records import TrackState, TrackUpdate
from stereo_speed.core.tracker_config import ClassConfig
from stereo_speed.detection.front_width import FrontWidth
from stereo_speed.lab.evaluation.labeled_sequence import read_back
from stereo_speed.lab.sim.bodies import BODIES
from stereo_speed.lab.sim.config import straight_config, VehicleConfig
from stereo_speed.lab.sim.sequence import simulate
from stereo_speed.site.file import load_site
from stereo_speed.site.lane_paths import lane_paths

CONFIG = ClassConfig()


@cache
def drawn(kind, **changes):
    """Return rig, lane, and some near pairs, each with the true position of the drawn front."""
    body = BODIES[kind]
    vehicle = VehicleConfig(kind=kind, solid=True, front_width_m=body.width_m,
                            front_height_m=body.front_m, clearance_m=body.clearance_m)
    sequence = simulate(straight_config(
        '45 mph', vehicles=(vehicle,), start_m=42.0, near_m=22.0, **changes),
        np.random.default_rng(5))
    lane = lane_paths(read_back(sequence.site_exact, load_site), sequence.rig)['lane_0']
    rows = {row['stamp_ns']: row for row in sequence.truth}
    return sequence.rig, lane, [
        (pair, update_of(rows[pair.stamp_ns], pair, lane, sequence.rig, body))
        for pair in sequence.pairs]


def update_of(row, pair, lane, rig, body):
    """Return an update at the true position."""
    at = np.array([row['x'], row['y'], row['z']])
    s_m = lane.path.arc_length(at)
    axes = lane.path.frame(np.array(s_m))
    across, up = body.width_m / 2, body.front_m / 2
    corners = at + np.array([[across, up], [-across, up], [-across, -up], [across, -up]]) \
        @ axes[:, 1:].T
    left, right, _, _ = rig.project(corners)
    return TrackUpdate(pair.stamp_ns, 0, 'lane_0', TrackState.CONFIRMED, row['speed'], 0.1,
                       float(s_m), 0.0, at, np.eye(3), axes, left, right)


def measured(rig, lane, rows, **changes):
    size = VehicleSize(rig, lane, CONFIG, **changes)
    for pair, update in rows:
        size.take(pair, update)
    return size.measured()


@pytest.mark.slow
@pytest.mark.parametrize(('kind', 'name', 'height_m'), [
    ('car', VehicleClass.CAR, (1.3, 1.65)), ('van', VehicleClass.VAN, (2.2, 2.65)),
    ('truck', VehicleClass.HEAVY_VEHICLE, (2.5, 3.7)),
    ('motorcycle', VehicleClass.MOTORCYCLE, (0.8, 1.8))])
def test_sizes_of_drawn_vehicles_are_measured(kind, name, height_m):
    found = measured(*drawn(kind))
    assert found.width_m == pytest.approx(BODIES[kind].width_m, abs=0.02)
    assert height_m[0] < found.height_m < height_m[1]
    assert (found.name, found.probability > 0.9) == (name, True)


def in_part(update, rig, low, high):
    """Return an update of a track of a part of the front, between shares of its width."""
    left, right = (np.concatenate([
        upper[0] + np.array([[low], [high]]) * (upper[1] - upper[0]),
        lower[0] + np.array([[high], [low]]) * (lower[1] - lower[0])])
        for upper, lower in ((quad[:2], quad[:1:-1]) for quad in (
            update.quad_left_px, update.quad_right_px)))
    middle = rig.triangulate(left.mean(axis=0), right.mean(axis=0))
    across_m = float((middle - update.position_m) @ update.axes[:, 1])
    return replace(update, quad_left_px=left, quad_right_px=right, lateral_m=across_m,
                   position_m=update.position_m + across_m * update.axes[:, 1])


@pytest.mark.slow
@pytest.mark.parametrize('delay_s', [0.0, 0.02, -0.08],
                         ids=['at once', 'right view later', 'right view earlier'])
@pytest.mark.parametrize('kind', ['car', 'truck'])
def test_partly_tracked_front_has_its_whole_width(kind, delay_s):
    """A pole hid the rest when the track began."""
    rig, lane, rows = drawn(kind, right_delay_s=delay_s)
    rows = [(pair, in_part(update, rig, 0.45, 1.0)) for pair, update in rows]
    width_m = BODIES[kind].width_m
    assert measured(rig, lane, rows).width_m == pytest.approx(0.55 * width_m, abs=0.03)
    found = measured(rig, lane, rows, fronts=FrontWidth(rig, lane))
    assert found.width_m == pytest.approx(width_m, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize('off_m', [-0.7, 0.7])
def test_partly_tracked_front_may_be_off_along_the_lane(off_m):
    """With a camera out of focus, the track of one side of a front was 0.65 m off."""
    rig, lane, rows = drawn('car')
    half = [(pair, in_part(update, rig, 0.45, 1.0)) for pair, update in rows]
    rows = [(pair, replace(update, s_m=update.s_m + off_m)) for pair, update in half]
    found = measured(rig, lane, rows, fronts=FrontWidth(rig, lane))
    assert found.width_m == pytest.approx(BODIES['car'].width_m, abs=0.1)


class Seen:
    """Returns widths measured in some pairs, by their stamps."""

    def __init__(self, widths_m):
        self._widths_m = widths_m

    def widths_m(self, pair, update):
        """Return the widths of a pair."""
        return self._widths_m.get(pair.stamp_ns, [])


@pytest.mark.slow
def test_width_needs_two_heights_in_one_pair_or_several_pairs():
    """A vehicle that is half hidden throughout is fully visible in few pairs, or in none."""
    rig, lane, rows = drawn('car')
    stamp_ns = rows[-1][0].stamp_ns  # of the nearest, which is kept
    assert measured(rig, lane, rows, fronts=Seen({stamp_ns: [1.9, 2.0]})).width_m == 1.95
    assert measured(rig, lane, rows, fronts=Seen({stamp_ns: [1.2]})).width_m == pytest.approx(
        BODIES['car'].width_m, abs=0.02)


@pytest.mark.slow
def test_two_wheeler_is_no_part_of_a_wider_front():
    """No front of a car is seen around it, so its width is that of the tracked part."""
    rig, lane, rows = drawn('motorcycle')
    one, other = (measured(rig, lane, rows, fronts=fronts)
                  for fronts in (None, FrontWidth(rig, lane)))
    assert one.width_m == other.width_m
    assert other.name == VehicleClass.MOTORCYCLE


@pytest.mark.slow
@pytest.mark.parametrize('receding', [False, True])
@pytest.mark.parametrize(('kind', 'share', 'marked_std_px', 'edge'), [
    ('truck', 0.5, None, True), ('truck', 1.0, None, False), ('truck', 0.5, 0.7, False),
    ('car', 0.5, None, False), ('motorcycle', 1.0, None, False)])
def test_narrow_front_of_something_high_is_an_edge(kind, share, marked_std_px, edge, receding):
    """It gives no readings until its height is known, and none then if it is an edge."""
    rig, lane, rows = drawn(kind)
    size = VehicleSize(rig, lane, CONFIG, marked_std_px)
    known = []
    for pair, update in rows[::-1] if receding else rows:
        size.take(pair, in_part(update, rig, 0.0, share))
        known.append(size.may_be_edge)
    narrow = marked_std_px is None and share * BODIES[kind].width_m < CONFIG.edge_width_m
    assert known[0] is narrow
    assert set(known[len(known) // 2:]) == {edge}


@pytest.mark.slow
@pytest.mark.parametrize(('height_m', 'edge'), [(0.11, True), (0.4, False)])
def test_narrow_front_of_something_low_is_an_edge_of_a_shadow(monkeypatch, height_m, edge):
    rig, lane, rows = drawn('motorcycle')
    monkeypatch.setattr(VehicleSize, '_height_m', lambda *_: height_m)
    size = VehicleSize(rig, lane, CONFIG)
    for pair, update in rows:
        size.take(pair, update)
    assert size.may_be_edge is edge


@pytest.mark.slow
@pytest.mark.parametrize('receding', [False, True])
def test_narrow_front_whose_height_stays_unknown_is_no_edge(receding):
    """In the dark the top of a motorcycle does not show."""
    rig, lane, rows = drawn('motorcycle')
    size = VehicleSize(rig, lane, replace(CONFIG, least_ncc=1.0))
    known = []
    for pair, update in rows[::-1] if receding else rows:
        size.take(pair, update)
        known.append(size.may_be_edge)
    assert size.measured().height_m is None
    assert known[0] and not known[-1]


@pytest.mark.slow
def test_edge_that_a_whole_front_is_seen_around_is_none():
    rig, lane, rows = drawn('truck')
    size = VehicleSize(rig, lane, CONFIG, fronts=FrontWidth(rig, lane))
    for pair, update in rows:
        size.take(pair, in_part(update, rig, 0.5, 1.0))
    assert not size.may_be_edge


@pytest.mark.slow
def test_exposure_and_lag_of_the_right_view_have_no_effect():
    """The vehicle moves 0.4 m until the right view is exposed."""
    found = measured(*drawn('van', right_delay_s=0.02, right_gain=0.8))
    assert found.name == VehicleClass.VAN
    assert found.height_m == pytest.approx(2.45, abs=0.2)


@pytest.mark.slow
def test_receding_vehicle_keeps_its_height_despite_similar_ranges():
    """The images end below the highest searched strip, so no pair decides by itself."""
    rig, lane, rows = drawn('car', fps=10.0, camera_height_m=2.0, camera_pitch_deg=8.0)
    found = measured(rig, lane, rows[-4:][::-1])  # at 23, 28 and 30 m
    assert found.height_m is not None and 1.3 < found.height_m < 1.65


@pytest.mark.slow
def test_height_is_unknown_where_all_pairs_have_the_same_range():
    rig, lane, rows = drawn('car')
    found = measured(rig, lane, rows[-1:])
    assert (found.height_m, found.height_std_m) == (None, None)
    assert measured(rig, lane, []) is None


@pytest.mark.slow
def test_stationary_object_has_no_height():
    """With the same image again nothing moves along."""
    rig, lane, rows = drawn('car')
    still = rows[-1][0]
    found = measured(rig, lane, [(replace(still, stamp_ns=pair.stamp_ns), update)
                                 for pair, update in rows])
    assert found.height_m is None


@pytest.mark.slow
def test_height_is_limited_by_the_search_range():
    rig, lane, rows = drawn('van')
    found = measured(rig, lane, rows, search=HeightSearch(most_m=1.2))
    assert 1.0 < found.height_m < 1.2 + HeightSearch().step_m


@pytest.mark.slow
def test_top_too_far_behind_the_front_does_not_count():
    """A windscreen 1 m behind the bumper is the vehicle's own; farther back it is another's."""
    rig, lane, rows = drawn('car')
    heights = [measured(rig, lane, rows, search=HeightSearch(most_depth_m=m)).height_m
               for m in (0.4, 4.0)]
    assert heights[0] < 1.15 and 1.3 < heights[1] < 1.65


def test_strips_overlap_and_cover_the_range_of_heights():
    search = HeightSearch()
    assert search.heights_m[[0, -1]] == pytest.approx([search.least_m, search.most_m])
    assert np.diff(search.heights_m) == pytest.approx(search.step_m)
    assert np.ptp(search.strip, axis=0) == pytest.approx(
        [search.width_share, 2 * search.half_height_m])


@pytest.mark.slow
def test_width_of_a_marked_front_is_as_certain_as_its_corners():
    rig, lane, rows = drawn('car')
    px_per_m = np.ptp(rows[0][1].quad_left_px[:, 0]) / BODIES['car'].width_m
    found = measured(rig, lane, rows, marked_std_px=0.7)
    assert found.width_std_m == pytest.approx(0.7 / px_per_m, rel=1e-3)
