# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The parameters that decide what a refinement finds, its uncertainty, and its warnings."""
from __future__ import annotations

from dataclasses import dataclass

from ...core.config import CheckedRecord, parameter


@dataclass(frozen=True)
class RefineConfig(CheckedRecord):
    """Parameters of the refinement of a site."""

    search_px: float = parameter(
        8.0, 1.0, 50.0, 'px', 'largest distance of a marking from the clicked line, several times '
        'the scatter of clicks')
    painted_share: float = parameter(
        0.5, 0.05, 0.95, '', 'share of the usual contrast below which a cross-section shows no '
        'marking but a gap or an occlusion')
    steady_share: float = parameter(
        0.1, 0.001, 100.0, '', 'largest change of light over time in a cross-section that may '
        'show a kerb or a dark band, as a share of the grey level and apart from exposure; '
        'sweeping headlamps change it by more, and only light bands count there')
    clicked_sigmas: float = parameter(
        3.0, 1.0, 100.0, '', 'largest distance of clicks outside the marking found for them, in '
        'sigmas of clicks combined with the distances of the other lines; beyond it the marking '
        'is another line; also of a far stretch, narrower than a pixel, from its clicks, beyond '
        'which these count there')
    floor_std_px: float = parameter(
        0.012, 0.0, 1.0, 'px', '1-sigma of a point that more cross-sections do not reduce, by '
        'texture, wear and the lens')
    correlated_sections: float = parameter(
        2.0, 1.0, 20.0, '', 'number of neighbouring cross-sections that share one error')
    stray_sigmas: float = parameter(
        5.0, 2.0, 50.0, '', 'points farther than this from the road of all lines are dropped, '
        'such as points on a rail or a shadow')
    detail_std_px: float = parameter(
        0.05, 0.001, 1.0, 'px', 'least 1-sigma of the match of a detail of the background')
    independent_details: float = parameter(
        60.0, 3.0, 1500.0, '', 'largest number of details that count as independent: errors of '
        'neighbours, or within one tree, are correlated')
    moved_std_deg: float = parameter(
        0.05, 0.001, 1.0, 'degrees', '1-sigma of each angle of a camera that has moved')
    moved_probability: float = parameter(
        0.05, 0.0001, 0.5, '', 'prior probability that an angle of the camera has moved')
    most_drift_deg: float = parameter(
        0.3, 0.01, 1.0, 'degrees', 'a camera that has moved by more than this must be calibrated '
        'again')
    disagreement_sigmas: float = parameter(
        4.0, 1.0, 100.0, '', 'largest difference of speeds on the refined and on the clicked '
        'lines, in combined sigmas; beyond it the clicks are kept, see disagreement_factor')
    disagreement_factor: float = parameter(
        2.0, 0.0, 100.0, '', 'the refined lines are kept nevertheless if the clicks lie off them '
        'by less than this many times their scatter about their own road')
    few_pairs: int = parameter(
        5, 1, 1000, '', 'with fewer pairs there is a warning, as the background may still show '
        'passing vehicles')
    worst_residual_px: float = parameter(
        0.15, 0.0, 10.0, 'px', 'r.m.s. distance of a marking from the road of all lines above '
        'which there is a warning; good ones are below 0.05')
    doubtful_probability: float = parameter(
        0.2, 0.0, 1.0, '', 'probability of an uncorrected drift above which there is a warning')
    worst_speed_std: float = parameter(
        0.0025, 0.0, 1.0, '', 'relative 1-sigma of speeds by path and rig above which there is a '
        'warning')
    length_sigmas: float = parameter(
        3.0, 1.0, 10.0, '', 'largest difference of a known length and the measured one, in '
        'combined sigmas')
