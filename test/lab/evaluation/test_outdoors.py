# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Outdoor passes equal the plain ones, plus the drawn conditions."""
from __future__ import annotations

from collections import Counter
from dataclasses import replace

import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.lab.evaluation.outdoors import check_held, OUTDOORS
from stereo_speed.lab.evaluation.random_passes import draw_pass
from stereo_speed.lab.sim.config import SimConfig

DRAWN = [draw_pass(1, number, outdoors={}) for number in range(84)]


def test_every_kind_is_drawn():
    for heading, kinds in OUTDOORS.items():
        assert {drawn.kinds[heading] for drawn in DRAWN} == set(kinds)
    assert set(Counter(drawn.kinds['vehicle'] for drawn in DRAWN).values()) == {12}  # in turns
    # Half of the cameras are sound: 42 of 84, with 4 binomial standard deviations of 4.6.
    assert abs(sum(drawn.kinds['fault'] == 'none' for drawn in DRAWN) - 42) < 19


def test_drawn_conditions_are_simulated():
    for drawn in DRAWN:
        config, kinds = drawn.config, drawn.kinds
        vehicle, = config.vehicles
        assert vehicle.solid and vehicle.kind == kinds['vehicle'] and config.light is not None
        assert (vehicle.lamp_grey > 255) == (kinds['lamps'] == 'clipping')
        assert (vehicle.lamp_grey > 0) == (kinds['lamps'] != 'off')
        assert (config.light.wet > 0) == (kinds['light'] == 'wet_night')
        assert (config.light.sun_elevation_deg is not None) == (kinds['light'] == 'sun')
        faults = config.faults
        assert (faults.right_defocus_px > 0) == (kinds['fault'] == 'defocus')
        assert (faults.exposure_step > 0) == (kinds['fault'] == 'exposure')
        assert (faults.dirt > 0) == (kinds['fault'] == 'dirt')
        assert (abs(config.right_gain - 1) > 0.1) == (kinds['fault'] == 'gain')


def test_fixed_conditions_are_not_drawn_and_change_no_road():
    held = {'vehicle': 'bus', 'lamps': 'dim', 'light': 'sun', 'fault': 'none'}
    for number in range(6):
        drawn, plain = draw_pass(1, number, outdoors=held), draw_pass(1, number)
        assert {k: drawn.kinds[k] for k in held} == held
        assert replace(drawn.config.road) == plain.config.road
        assert drawn.config.vehicles[0].speed_mps == plain.config.vehicles[0].speed_mps
        assert drawn.config.noise_grey == plain.config.noise_grey
        assert plain.config.lens == SimConfig().lens


@pytest.mark.parametrize('held, said', [
    ({'colour': 'red'}, '--outdoors: found colour, wanted one of vehicle'),
    ({'fault': 'rust'}, '--outdoors fault: found rust, wanted one of none'),
    ({'vehicle': 'tank'}, '--outdoors vehicle')])
def test_unknown_conditions_are_refused(held, said):
    with pytest.raises(InputError, match=said):
        check_held(held)
