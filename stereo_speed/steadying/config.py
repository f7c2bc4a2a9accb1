# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the steadying, with default, unit, bounds and meaning."""
from __future__ import annotations

from dataclasses import dataclass

from ..core.config import CheckedRecord, parameter


@dataclass(frozen=True)
class SteadyingConfig(CheckedRecord):
    """How the rotation of the cameras is estimated in each pair, by static details."""

    enabled: bool = parameter(
        True, doc='estimate the rotation of the cameras; otherwise they are assumed to stand '
        'still')
    look_interval_s: float = parameter(
        0.5, 0.0, 60.0, 's', 'time between two looks at pairs while the cameras stand still; 0 '
        'looks at every pair')
    still_looks: int = parameter(
        5, 1, 1000, '', 'number of looks in a row without motion after which the cameras are '
        'taken to stand still; until then, and after any motion, every pair is looked at. A pair '
        'that shows no details counts as one without motion, unless the rig has swayed before')
    details: int = parameter(
        250, 20, 2000, '', 'largest number of details, small patches of a view whose places tell '
        'its rotation')
    least_details: int = parameter(
        12, 4, 2000, '', 'smallest number of visible details for a known rotation')
    least_ncc: float = parameter(
        0.7, 0.0, 1.0, '', 'a detail that correlates less with its learnt appearance is hidden')
    outlier_sigmas: float = parameter(
        3.0, 0.5, 20.0, '', 'details farther from the common rotation, in their sigmas, are left '
        'out because they move by themselves')
    most_spread_px: float = parameter(
        0.4, 0.01, 10.0, 'px', 'robust r.m.s. distance of the details from the common rotation '
        'above which the rotation is unknown, as the camera then drives rather than rotates')
    detail_floor_px: float = parameter(
        0.03, 0.0, 1.0, 'px', 'systematic error of the place of one detail, caused by '
        'interpolation and light')
    independent_details: float = parameter(
        60.0, 3.0, 2000.0, '', 'largest number of details that count as independent: errors of '
        'neighbours are correlated')
    sway_std_deg: float = parameter(
        0.05, 0.0001, 5.0, 'degrees', '1-sigma of each angle of a rig that sways')
    sway_probability: float = parameter(
        0.1, 0.0, 1.0, '', 'prior share of pairs in which the rig has swayed')
    drift_std_deg: float = parameter(
        0.05, 0.0001, 5.0, 'degrees', '1-sigma of each angle of a right camera that has turned '
        'relative to the left one')
    drift_probability: float = parameter(
        0.001, 0.0, 1.0, '', 'prior share of pairs in which the right camera has turned')
    drift_rate_deg: float = parameter(
        1e-5, 0.0, 1.0, 'degrees', '1-sigma of the slow change of each of these angles from one '
        'pair to the next')
    drift_floor_deg: float = parameter(
        0.0003, 0.0, 1.0, 'degrees', 'systematic error of each of these angles, caused by light '
        'and moving objects, which averaging over pairs does not reduce')
    drift_sigmas: float = parameter(
        4.0, 0.0, 100.0, '', 'significance of the angles, in sigmas, from which the right camera '
        'has turned and is corrected')
    most_drift_deg: float = parameter(
        0.3, 0.001, 10.0, 'degrees', 'if the right camera has turned by more than this, it is not '
        'corrected and nothing is measured')
    learning_share: float = parameter(
        0.3, 0.0, 1.0, '', 'weight of the recent appearance of the details when they are learnt '
        'anew, which follows slow changes of light')
    renew_pairs: int = parameter(
        100, 2, 100000, '', 'number of looks after which details are learnt anew, and those '
        'hidden in most of the pairs are replaced')
