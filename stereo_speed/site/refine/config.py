# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""The numbers that decide what a refinement finds, how certain it is, and what it warns of."""
from __future__ import annotations

from dataclasses import dataclass

from ...core.config import CheckedRecord, parameter


@dataclass(frozen=True)
class RefineConfig(CheckedRecord):
    """Parameters of the refinement of a site."""

    search_px: float = parameter(
        8.0, 1.0, 50.0, 'px', 'how far from the clicked line its marking may lie: some times the '
        'scatter of clicks')
    painted_share: float = parameter(
        0.5, 0.05, 0.95, '', 'share of the usual contrast below which a cross-section shows no '
        'marking: a gap, or something in front')
    steady_share: float = parameter(
        0.1, 0.001, 100.0, '', 'change of the light over time, as a share of the grey level and '
        'beside exposure, beyond which a cross-section does not count: lamps that sweep the road')
    clicked_sigmas: float = parameter(
        3.0, 1.0, 100.0, '', 'sigmas of clicks, and of what they do beside the other lines, by '
        'which they may lie outside what was found for them; beyond it, it is another line')
    floor_std_px: float = parameter(
        0.012, 0.0, 1.0, 'px', '1-sigma of a point that more cross-sections do not improve: '
        'texture, wear, the lens')
    correlated_sections: float = parameter(
        2.0, 1.0, 20.0, '', 'number of neighbouring cross-sections that share one error')
    stray_sigmas: float = parameter(
        5.0, 2.0, 50.0, '', 'points further from the road of all lines are dropped: a rail, a '
        'shadow')
    detail_std_px: float = parameter(
        0.05, 0.001, 1.0, 'px', 'no detail of the background is matched better than this')
    independent_details: float = parameter(
        60.0, 3.0, 1500.0, '', 'errors of neighbours, and of one tree, are alike: more details '
        'than this add nothing')
    moved_std_deg: float = parameter(
        0.05, 0.001, 1.0, 'degrees', '1-sigma of an angle of a camera that has moved')
    moved_probability: float = parameter(
        0.05, 0.0001, 0.5, '', 'share of rigs of which one angle has moved, beforehand')
    most_drift_deg: float = parameter(
        0.3, 0.01, 1.0, 'degrees', 'a camera that has moved by more is another rig: calibrate '
        'again')
    disagreement_sigmas: float = parameter(
        4.0, 1.0, 100.0, '', 'sigmas of both by which speeds on the refined lines may differ from '
        'those on the clicked ones; beyond it the clicks are kept')
    disagreement_factor: float = parameter(
        2.0, 0.0, 100.0, '', 'unless the clicks lie off the refined lines by less than so many '
        'times their scatter about the road that they make themselves')
    few_pairs: int = parameter(
        5, 1, 1000, '', 'with fewer pairs a median may still show what passed: warn')
    worst_residual_px: float = parameter(
        0.15, 0.0, 10.0, 'px', 'r.m.s. distance of a marking from the road of all lines beyond '
        'which to warn; good ones are below 0.05')
    doubtful_probability: float = parameter(
        0.2, 0.0, 1.0, '', 'probability of a drift that is not corrected beyond which to warn')
    worst_speed_std: float = parameter(
        0.0025, 0.0, 1.0, '', '1-sigma that path and rig leave of speeds, as a share, beyond '
        'which to warn')
    length_sigmas: float = parameter(
        3.0, 1.0, 10.0, '', 'sigmas by which a known length may differ from the measured one')
