# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the steadying: default, unit, bounds and meaning."""
from __future__ import annotations

from dataclasses import dataclass

from ..core.config import CheckedRecord, parameter


@dataclass(frozen=True)
class SteadyingConfig(CheckedRecord):
    """How the rotation of the cameras is estimated in each pair, by details that stand still."""

    enabled: bool = parameter(
        True, doc='estimate how the cameras have rotated; without it they are taken to stand '
        'still')
    look_interval_s: float = parameter(
        0.5, 0.0, 60.0, 's', 'while the cameras stand still, only one pair in this time is looked '
        'at; 0 looks at each')
    still_looks: int = parameter(
        5, 1, 1000, '', 'pairs looked at in a row that show no motion, after which the cameras '
        'are taken to stand still; until then, and once one has moved, each pair is looked at; '
        'a pair in which nothing is to be seen shows none, unless the rig has swayed before')
    details: int = parameter(
        250, 20, 2000, '', 'small patches of each view, at most, whose places tell its rotation')
    least_details: int = parameter(
        12, 4, 2000, '', 'with fewer of them to be seen, the rotation in a pair is unknown')
    least_ncc: float = parameter(
        0.7, 0.0, 1.0, '', 'a detail that correlates less with what it looked like is hidden')
    outlier_sigmas: float = parameter(
        3.0, 0.5, 20.0, '', 'details further off the common rotation, in their sigmas, do not '
        'count: they move by themselves')
    most_spread_px: float = parameter(
        0.4, 0.01, 10.0, 'px', 'details that lie further off the common rotation, by their robust '
        'r.m.s., show a camera that drives, not one that rotates: its rotation is unknown')
    detail_floor_px: float = parameter(
        0.03, 0.0, 1.0, 'px', 'systematic error of the place of one detail, by its interpolation '
        'and by light')
    independent_details: float = parameter(
        60.0, 3.0, 2000.0, '', 'errors of neighbours are alike: more details than this do not '
        'make the rotation more certain')
    sway_std_deg: float = parameter(
        0.05, 0.0001, 5.0, 'degrees', '1-sigma of each angle of a rig that sways')
    sway_probability: float = parameter(
        0.1, 0.0, 1.0, '', 'share of pairs in which the rig has swayed, beforehand')
    drift_std_deg: float = parameter(
        0.05, 0.0001, 5.0, 'degrees', '1-sigma of each angle of a right camera that has turned '
        'against the left one')
    drift_probability: float = parameter(
        0.001, 0.0, 1.0, '', 'share of pairs in which it has, beforehand')
    drift_rate_deg: float = parameter(
        1e-5, 0.0, 1.0, 'degrees', 'by which each of these angles may have changed from one pair '
        'to the next without having turned')
    drift_floor_deg: float = parameter(
        0.0003, 0.0, 1.0, 'degrees', 'systematic error of each of these angles, by light and '
        'by what moves, which no number of pairs averages away')
    drift_sigmas: float = parameter(
        4.0, 0.0, 100.0, '', 'a right camera has turned, and is corrected, when its angles are '
        'so many of their sigmas off')
    most_drift_deg: float = parameter(
        0.3, 0.001, 10.0, 'degrees', 'a right camera that has turned by more is not corrected: '
        'nothing is measured')
    learning_share: float = parameter(
        0.3, 0.0, 1.0, '', 'share of what the details look like that is learnt anew every '
        'renew_pairs, so that slow changes of the light are followed')
    renew_pairs: int = parameter(
        100, 2, 100000, '', 'pairs looked at after which details are learnt anew, and those that '
        'were hidden in most of them replaced by others')
