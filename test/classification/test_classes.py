# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Classes of vehicles by their sizes."""
from dataclasses import replace
import math

import pytest
from stereo_speed.classification.classes import classified, is_edge, is_low
from stereo_speed.core.passes import VehicleClass
from stereo_speed.core.tracker_config import ClassConfig

CONFIG = ClassConfig()


@pytest.mark.parametrize(('width_m', 'height_m', 'name'), [
    (1.76, 1.46, 'car'), (1.65, 1.50, 'car'), (1.90, 1.70, 'car'),
    (1.95, 2.45, 'van'), (2.05, 2.60, 'van'),
    (2.50, 3.00, 'heavy_vehicle'), (2.55, 3.60, 'heavy_vehicle'), (2.45, 0.9, 'heavy_vehicle'),
    (0.45, 1.30, 'motorcycle'), (0.80, 1.60, 'motorcycle'), (0.6, None, 'motorcycle'),
    (1.97, 1.90, 'unknown'), (1.95, None, 'unknown'), (1.80, 3.60, 'unknown')])
def test_common_sizes(width_m, height_m, name):
    assert classified(width_m, 0.08, height_m, CONFIG).name == name


@pytest.mark.parametrize(('width_m', 'height_m', 'edge'), [
    (0.42, 2.8, True), (0.8, 1.7, False), (1.8, 2.8, False), (0.42, None, False)])
def test_narrow_object_taller_than_a_rider_is_an_edge(width_m, height_m, edge):
    assert is_edge(classified(width_m, 0.08, height_m, CONFIG), CONFIG) is edge


@pytest.mark.parametrize(('height_m', 'low'), [
    (0.11, True), (0.25, True), (0.27, False), (0.6, False), (1.02, False), (None, False)])
def test_nothing_moving_as_high_as_headlamps_is_no_vehicle(height_m, low):
    """By two 1-sigmas of 0.12 m: a shadow's edge measured 0.11 m, the lowest cars are 1.02 m."""
    assert is_low(classified(0.8, 0.08, height_m, CONFIG), CONFIG) is low


@pytest.mark.parametrize(('width_m', 'height_m'), [(1.48, 1.6), (1.4, 1.4), (1.95, 1.5)])
def test_cars_of_all_widths_are_cars(width_m, height_m):
    """From kei cars, of which a detected front may miss some centimetres, to large ones."""
    assert classified(width_m, 0.08, height_m, CONFIG).name == VehicleClass.CAR


@pytest.mark.parametrize(('width_m', 'name'), [
    (2.05, VehicleClass.UNKNOWN), (1.1, VehicleClass.UNKNOWN), (0.95, VehicleClass.MOTORCYCLE)])
def test_width_between_two_classes_is_unknown_without_a_height(width_m, name):
    assert classified(width_m, 0.08, None, CONFIG).name == name


def test_height_seen_behind_a_car_does_not_make_it_a_lorry():
    """Its own width excludes a lorry; the height is then not used."""
    never = replace(CONFIG, odd_height_share=0.0)
    assert classified(1.84, 0.08, 3.6, never).name == VehicleClass.HEAVY_VEHICLE
    assert classified(1.84, 0.08, 3.6, CONFIG).name == VehicleClass.UNKNOWN


def test_probability_by_hand():
    """Without a height it is the ratio of the four width likelihoods."""
    def likelihood(mean, std):
        std = math.hypot(std, 0.1)
        return 0.02 / 3.0 + 0.98 * math.exp(-0.5 * ((1.9 - mean) / std) ** 2) / (
            std * math.sqrt(2 * math.pi))
    each = [likelihood(1.8, 0.15), likelihood(2.0, 0.07), likelihood(2.5, 0.06),
            likelihood(0.65, 0.15)]
    found = classified(1.9, 0.1, None, CONFIG)
    assert found.probability == pytest.approx(max(each) / sum(each), rel=1e-6)
    assert (found.name, found.height_std_m) == (VehicleClass.UNKNOWN, None)


def test_dark_top_is_weaker_evidence_against_a_lorry_than_a_low_one():
    dark, never = CONFIG, replace(CONFIG, hidden_top_share=0.0, odd_height_share=0.0)
    assert classified(2.45, 0.08, 0.9, dark).name == VehicleClass.HEAVY_VEHICLE
    assert classified(2.45, 0.08, 0.9, never).name != VehicleClass.HEAVY_VEHICLE


def test_unusual_size_is_unknown():
    found = classified(30.0, 0.08, None, CONFIG)
    assert found.name == VehicleClass.UNKNOWN
    assert found.probability == pytest.approx(0.25)
