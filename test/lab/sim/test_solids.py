# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Bodies with depth: the positions of their pieces, and invariants."""
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.lab.sim import (
    RigConfig, RoadConfig, SimConfig, simulate, straight_config, VehicleConfig)
from stereo_speed.lab.sim.bodies import BODIES, draw_body_size
from stereo_speed.lab.sim.planes import Eye
from stereo_speed.lab.sim.scene import Place, SimScene, Vehicle
from stereo_speed.lab.sim.solids import beam, draw_front
from stereo_speed.lab.sim.street import looks_of
from stereo_speed.lab.sim.view import rig_views

TINY = RigConfig(width_px=96, height_px=72, f_px=168.0)
KINDS = sorted(set(BODIES) - {''})


def _pose(body, receding=False):
    scene = SimScene(straight_config(road=RoadConfig(receding=(0,) if receding else ())))
    return scene, scene.front(Vehicle(0, body, lambda _: Place(45.0, 0.0, 0, 10.0, 0.0)), 0.0)


@pytest.mark.parametrize('kind', KINDS)
def test_depth_changes_images_but_no_truth(kind):
    flat = SimConfig(rig=TINY, pairs=3, fps=5.0, vehicles=(VehicleConfig(kind=kind),))
    solid = replace(flat, vehicles=(replace(flat.vehicles[0], solid=True, gloss=0.8,
                                            lamp_grey=4000.0),))
    one, other = (simulate(c, np.random.default_rng(0)) for c in (flat, solid))
    assert one.truth == other.truth and one.site == other.site and one.init == other.init
    assert any(np.any(a.left != b.left) for a, b in zip(one.pairs, other.pairs))


@pytest.mark.parametrize('kind', sorted(set(KINDS) - {'motorcycle'}))
def test_foremost_part_of_a_front_is_where_the_plane_would_be(kind):
    rng = np.random.default_rng(3)
    for _ in range(3):
        body = replace(draw_body_size(kind, rng), relief_m=0.01)
        front = draw_front(rng, body, 100.0)
        assert front.relief_m.max() == 0.0
        assert 0.1 < -front.relief_m.min() < 0.5
        # Lamps and grille lie at different depths, by centimetres.
        assert 0.02 < front.relief_m.std() < 0.15
        assert 0 < front.lamp_up_m < body.front_m
        assert 0 < front.lamp_side_m < body.width_m / 2


@pytest.mark.parametrize('rear', [False, True])
def test_motorcycle_is_as_deep_as_it_is_wide(rear):
    body = replace(BODIES['motorcycle'], lamp_grey=3000.0)
    _, pose = _pose(body, rear)
    looks = looks_of(body, rear, np.random.default_rng(2))
    planes = looks.planes(pose)
    sign = -1 if rear else 1
    places = (np.array([p.outline_m for p in planes]) - pose.ground_m) @ pose.axes
    ahead, left, up = np.moveaxis(sign * places * [1, 1, sign], -1, 0)
    assert np.ptp(ahead) > 1.0 and np.abs(left).max() < 0.55 and 1.5 < up.max() < 1.75
    # Its lamp is in the plane that is tracked.
    lamp, = (i for i, p in enumerate(planes) if p.emits is not None)
    np.testing.assert_allclose(ahead[lamp], 0.0, atol=1e-9)
    assert all(p.normal @ pose.axes[:, 0] * sign > 0 for p in planes)
    if not rear:
        helmet = up.max(axis=1).argmax()
        assert ahead[helmet].mean() < -0.7 and ahead.max() == pytest.approx(0.5)


def test_lamps_shine_ahead():
    _, pose = _pose(BODIES['car'])
    ahead = pose.axes[:, 0]
    shares = [beam(replace(pose, axes=pose.axes), at) for at in (-30 * ahead, 30 * ahead)]
    assert shares == pytest.approx([1.0, 1.0])  # straight ahead, and from behind a rear lamp
    above = -30 * ahead - 10 * pose.axes[:, 2]
    assert beam(pose, above) == pytest.approx(0.08, abs=0.01)


def test_bright_lamps_of_solid_bodies_clip():
    counts = []
    for grey in (0.0, 200.0, 8000.0):
        body = replace(BODIES['van'], solid=True, lamp_grey=grey)
        scene, pose = _pose(body)
        image = np.full((768, 1024), 60.0, np.float32)
        eye = Eye(rig_views(scene.rig)[0])
        for plane in looks_of(body, False, np.random.default_rng(0)).planes(pose):
            eye.draw(image, plane)
        counts.append(int((image >= 255).sum()))
    assert counts[0] == 0 and counts[2] > 50 and counts[2] > 2 * counts[1]


def test_front_alone_cannot_be_solid():
    with pytest.raises(InputError, match='vehicle.solid'):
        straight_config(vehicles=(VehicleConfig(kind='', solid=True),))
