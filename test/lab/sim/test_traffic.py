# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A stream of traffic: repeatable, with consistent truth; sequences with everything."""
from __future__ import annotations

import csv
from dataclasses import replace
import itertools
from unittest import mock

import numpy as np
import pytest

from stereo_speed.core.errors import InputError
from stereo_speed.lab.sim import (
    DAY, DUSK, FaultConfig, LensConfig, LightConfig, ParkedConfig, PersonConfig, PoleConfig,
    RigConfig, RoadConfig, simulate, straight_config, traffic_config, TrafficStream, TreeConfig,
    VehicleConfig)
from stereo_speed.lab.sim.planes import Eye
from stereo_speed.lab.sim.write import write_traffic_bag
from stereo_speed.site.file import load_site
from stereo_speed.site.lane_paths import lane_paths
import yaml

SMALL = RigConfig(width_px=320, height_px=240, f_px=560.0)


def _config(light='day', receding=0, vehicles=40, **changes):
    return traffic_config(light, 3, receding, 10.0, 1.0, vehicles, rig=SMALL, **changes)


def _take(config, seed, count):
    return list(itertools.islice(TrafficStream(config, np.random.default_rng(seed)), count))


@pytest.fixture(scope='module')
def stream():
    """Return 22 s of busy traffic in both directions, with lane changes and braking."""
    config = replace(
        _config('overcast', receding=1, vehicles=60), change_share=0.5, brake_share=0.5)
    with mock.patch.multiple(Eye, draw=lambda *_: None, fill=lambda *_: None):
        return config, _take(config, 3, 220)  # the truth needs no images


def test_same_seed_gives_the_same_stream_and_another_does_not():
    config = _config('dusk', receding=1, vehicles=15)
    one, two, other = _take(config, 1, 4), _take(config, 1, 4), _take(config, 2, 4)
    for a, b, c in zip(one, two, other):
        assert np.array_equal(a.pair.left, b.pair.left)
        assert np.array_equal(a.pair.right, b.pair.right)
        assert a.truth == b.truth
        assert not np.array_equal(a.pair.left, c.pair.left)
    assert [p.pair.index for p in one] == list(range(4))


@pytest.mark.slow
def test_truth_is_consistent(stream):
    """Speed is the distance between pairs over time; places run along the lanes."""
    config, pairs = stream
    rows = {}
    for one in pairs:
        for row in one.truth:
            rows.setdefault(row['vehicle'], []).append(row)
    changed = braked = receded = 0
    for track in rows.values():
        places = np.array([[row[k] for k in 'xyz'] for row in track])
        speeds = np.array([row['speed'] for row in track])
        steps_s = np.diff([row['stamp_ns'] for row in track]) * 1e-9
        ways = np.linalg.norm(np.diff(places, axis=0), axis=1)
        close = np.isclose(steps_s, 0.1)
        # An acceleration that changes within a step leaves less than a step's change of speed.
        np.testing.assert_allclose(ways[close] / 0.1, ((speeds[1:] + speeds[:-1]) / 2)[close],
                                   atol=0.08)
        away = track[0]['lane'] == 2
        assert np.all(np.diff(places[:, 2])[close] > 0) == away
        receded += away
        assert all(row['speed'] >= row['path_speed'] - 1e-6 for row in track)
        assert all(abs(row['lateral']) <= 3.7 / 2 + 1e-9 for row in track)
        changed += len({row['lane'] for row in track}) > 1
        braked += np.ptp(speeds) > 2.0
    assert len(rows) > 15 and changed >= 2 and braked >= 3 and receded >= 3


@pytest.mark.slow
def test_fronts_lie_above_their_lanes(stream):
    config, pairs = stream
    scene = TrafficStream(config, np.random.default_rng(3)).scene
    for one in pairs[::20]:
        for row in one.truth:
            world = (np.array([row[k] for k in 'xyz']) @ scene.left_R_world
                     + scene.centre_world_m)
            way = -1 if row['lane'] == 2 else 1
            assert world[1] == pytest.approx(row['lane'] * 3.7 + way * row['lateral'], abs=1e-6)
            assert 0.4 < world[2] < 2.5


@pytest.mark.slow
def test_visibility_of_fronts(stream):
    _, pairs = stream
    rows = [row for one in pairs for row in one.truth]
    shares = np.array([row['visible'] for row in rows])
    assert shares.min() >= 0 and shares.max() == 1.0
    assert (shares < 0.5).any()  # the pole and larger vehicles hide some
    whole = [row['visible'] for row in rows if row['in_view'] and row['width_px'] > 15]
    assert np.mean(np.array(whole) > 0.9) > 0.6
    # Nearer than the pass's end, or cut by the image's edge: not in view.
    assert any(not row['in_view'] for row in rows)


@pytest.mark.slow
def test_vehicles_are_drawn_at_their_true_places():
    """Where a front is unoccluded the image differs from the empty road, but not beside it."""
    config = _config('overcast', vehicles=30, noise_grey=0.0, poles=(), trees=(), people=())
    config = replace(config, scene=replace(config.scene, light=None))
    pairs = _take(config, 5, 70)
    empty = np.median([one.pair.left for one in pairs], axis=0)
    scene = TrafficStream(config, np.random.default_rng(5)).scene
    inside = []
    for one in pairs[::5]:
        differs = np.abs(one.pair.left.astype(float) - empty) > 4
        for row in one.truth:
            if row['in_view'] and row['visible'] > 0.95 and row['width_px'] > 18:
                uv = scene.rig.project(np.array([row[k] for k in 'xyz']))[0]
                u, v = uv.round().astype(int)
                half = int(row['width_px'] * 0.4)
                inside.append(differs[v - 3:v + 4, u - half:u + half].mean())
        if not one.truth:
            assert differs.mean() < 0.02
    assert len(inside) > 6 and np.median(inside) > 0.7


def test_gaps_drops_and_stamps():
    config = _config(vehicles=5, gaps_s=((0.55, 1.35),), drop=(2,), right_delay_s=0.004)
    pairs = _take(config, 0, 12)
    times = [(one.pair.stamp_ns - config.scene.origin_ns) * 1e-9 for one in pairs]
    np.testing.assert_allclose(
        times, [0.0, 0.1, 0.3, 0.4, 0.5, 1.4, 1.5, 1.6, 1.7, 1.8, 1.9, 2.0], atol=1e-9)
    assert {one.pair.right_stamp_ns - one.pair.stamp_ns for one in pairs} == {4_000_000}


def test_bag_of_traffic_is_readable(tmp_path):
    config = replace(_config(receding=1, vehicles=8), minutes=0.02)
    stream = TrafficStream(config, np.random.default_rng(0))
    folder = write_traffic_bag(stream, tmp_path / 'out')
    site = load_site(folder / 'site.yaml')
    assert [lane.name for lane in site.lanes] == ['lane_0', 'lane_1', 'lane_2']
    with (folder / 'truth.csv').open() as file:
        rows = list(csv.DictReader(file))
    assert rows and {'speed', 'x', 'lane', 'visible', 'in_view'} <= set(rows[0])
    assert (folder / 'bag' / 'metadata.yaml').exists()


def test_lanes_of_both_directions_point_along_travel(tmp_path):
    config = traffic_config('day', 3, 1, rig=RigConfig())
    stream = TrafficStream(config, np.random.default_rng(0))
    lines = stream.site['lines']
    lanes = {lane['name']: lane for lane in stream.site['lanes']}
    assert lanes['lane_2']['right'] == 'edge_left' and lanes['lane_2']['left'] == 'line_1_away'
    down = {name: np.diff(np.array(line['left_image'])[:, 1]).mean() > 0
            for name, line in lines.items()}
    assert down == {'edge_right': True, 'line_0': True, 'line_1': True, 'line_1_away': False,
                    'edge_left': False}


def test_sequence_with_everything():
    plain = straight_config(rig=SMALL, fps=5.0, noise_grey=0.0)
    road = RoadConfig(lanes=2, receding=(1,))
    cars = (VehicleConfig(kind='suv'), VehicleConfig(lane=1, kind='truck', speed_mps=15.0,
                                                     front_width_m=2.4, front_height_m=2.8))
    config = replace(
        plain, road=road, vehicles=cars, light=DAY, poles=(PoleConfig(),), right_delay_s=0.002,
        people=(PersonConfig(),), trees=(TreeConfig(),), parked=(ParkedConfig(),),
        gaps_s=((0.9, 1.3),))
    sequence = simulate(config, np.random.default_rng(0))
    places = {n: [row['z'] for row in sequence.truth if row['vehicle'] == n] for n in (0, 1)}
    assert np.all(np.diff(places[0]) < 0) and np.all(np.diff(places[1]) > 0)
    assert max(places[1]) < 73.0
    steps = np.diff([pair.stamp_ns for pair in sequence.pairs]) * 1e-9
    assert steps.max() == pytest.approx(0.6)
    assert all(p.right_stamp_ns - p.stamp_ns == 2_000_000 for p in sequence.pairs)
    assert len(sequence.init['vehicles']) == 2
    again = simulate(config, np.random.default_rng(0))
    assert all(np.array_equal(a.right, b.right)
               for a, b in zip(sequence.pairs, again.pairs))


def test_right_image_is_of_its_own_time():
    """With a delay the right view shows the vehicle where it was at its later stamp."""
    still = straight_config('50 mph', rig=replace(SMALL, baseline_m=1e-6), noise_grey=0.0,
                            pairs=3)
    late = replace(still, right_delay_s=0.2)
    one, other = (simulate(c, np.random.default_rng(4)) for c in (still, late))
    for k in (0, 1):
        # 0.2 s later is the next pair; the two cameras are at one place.
        gap = other.pairs[k].right.astype(float) - one.pairs[k + 1].left
        assert np.abs(gap).max() <= 1.0
        assert np.abs(one.pairs[k].right.astype(float) - one.pairs[k + 1].left).max() > 20


def test_pole_occludes_and_headlights_illuminate():
    base = straight_config(rig=SMALL, pairs=4, noise_grey=0.0,
                           vehicles=(VehicleConfig(kind='car'),))
    # A pole in the line of sight to the vehicle in its third pair.
    free = simulate(base, np.random.default_rng(0))
    scene_pair = simulate(replace(base, poles=(PoleConfig(
        ahead_m=12.0, right_m=0.0, radius_m=0.4, height_m=9.0),)), np.random.default_rng(0))
    gap = np.abs(scene_pair.pairs[2].left.astype(float) - free.pairs[2].left)
    columns = np.flatnonzero(gap.max(axis=0) > 6)
    assert 30 < columns.max() - columns.min() < 45  # 0.8 m at 12 m, 560 px focal length
    dusk = replace(base, exposure=0.35)
    lit = simulate(replace(dusk, light=replace(DUSK, drift=0.0)), np.random.default_rng(0))
    dark = simulate(dusk, np.random.default_rng(0))
    more = lit.pairs[3].left.astype(float) - dark.pairs[3].left
    assert more.max() > 80 and (more > 5).sum() > 300  # the lamps, and the pool before them
    assert more.min() > -3
    assert free.truth[2]['vehicle'] == 0


def test_outdoor_traffic_has_every_kind_with_depth_and_lamps():
    for light in ('day', 'wet_night'):
        config = _config(light, outdoors=True)
        rng = np.random.default_rng(0)
        bodies = [config.draw_body(rng) for _ in range(400)]
        assert all(body.solid and body.gloss > 0 for body in bodies)
        shares = {kind: sum(b.kind == kind for b in bodies) / 400 for kind, _ in config.kinds}
        for kind, share in config.kinds:  # 4 binomial standard deviations
            assert abs(shares[kind] - share) < 4 * np.sqrt(share * (1 - share) / 400)
        lit = np.mean([body.lamp_grey > 0 for body in bodies])
        assert lit == 1.0 if light == 'wet_night' else 0.6 < lit < 0.8
        assert bool(config.scene.street_lamps) == (light == 'wet_night')


@pytest.mark.parametrize('make, what', [
    (lambda: traffic_config('noon'), 'light'),
    (lambda: straight_config(road=RoadConfig(receding=(5,))), 'road.receding'),
    (lambda: straight_config(vehicles=(VehicleConfig(kind='tank'),)), 'vehicle.kind'),
    (lambda: straight_config(rig_moved_deg=(20.0, 0, 0)), 'rig_moved_deg'),
    (lambda: straight_config(lens=LensConfig(halo_share=1.0)), 'lens'),
    (lambda: straight_config(faults=FaultConfig(exposure_step=1.5)), 'faults.exposure_step'),
    (lambda: straight_config(faults=FaultConfig(right_defocus_px=-1.0)), 'faults'),
    (lambda: straight_config(light=LightConfig(ambient=0.0)), 'light.ambient')])
def test_bad_values_are_refused(make, what):
    with pytest.raises(InputError, match=what):
        make()


@pytest.mark.parametrize('receding', [0, 1, 2])
def test_picked_site_of_traffic_gives_paths_along_travel(tmp_path, receding):
    stream = TrafficStream(traffic_config('day', 3, receding), np.random.default_rng(0))
    path = tmp_path / 'site.yaml'
    path.write_text(yaml.safe_dump(dict(stream.site)))
    lanes = lane_paths(load_site(path), stream.rig)
    for k, lane in enumerate(lanes.values()):
        way = -1 if k >= 3 - receding else 1
        for station in (5.0, 30.0, 55.0):
            true = stream.scene.to_left(stream.scene.road.position(station, 3.7 * k))
            at = lane.path.arc_length(true)
            assert np.linalg.norm(lane.path.position(at) - true) < 0.3
            frame = stream.scene.left_R_world @ stream.scene.road.frame(station, 3.7 * k)
            np.testing.assert_allclose(lane.path.frame(at), frame * [way, way, 1.0], atol=0.01)


def test_lane_between_opposing_lines_is_refused(tmp_path):
    stream = TrafficStream(traffic_config('day', 2, 1), np.random.default_rng(0))
    site = dict(stream.site)
    site['lanes'] = [{**site['lanes'][0], 'left': 'edge_left'}]
    path = tmp_path / 'site.yaml'
    path.write_text(yaml.safe_dump(site))
    with pytest.raises(InputError, match='edge_right against edge_left'):
        lane_paths(load_site(path), stream.rig)
