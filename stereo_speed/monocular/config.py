# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Parameters of the monocular tracker, each with default, unit, bounds and meaning.

Lengths in the motion models are shares of the target's size, the square root of the area of its
box, so that the filter does not depend on image resolution and distance; times are in frames of
the video.
"""
from __future__ import annotations

from dataclasses import dataclass, replace

from ..core.config import CheckedRecord, parameter
from ..core.errors import InputError


@dataclass(frozen=True)
class MonocularConfig(CheckedRecord):
    """Parameters of the monocular tracker, with and without the environment."""

    particles: int = parameter(150, 10, 100000, '', 'number of particles N')

    lambda_b: float = parameter(
        20.0, 0.0, 1e4, '', 'weight lambda_b of the Bhattacharyya distance, eq. 23')
    surround_weight: float = parameter(
        4.0, 0.0, 100.0, '', 'how much colours shared with the surroundings of the initial box '
        'are down-weighted; 0 as in the paper')
    contrast_weight: float = parameter(
        5.0, 0.0, 1e4, '', 'weight of the contrast with the surroundings of the box; 0 as in '
        'the paper')
    parts: int = parameter(
        3, 1, 6, '', 'parts of the box from top to bottom with a histogram each; 1 as in the '
        'paper')
    samples_across: int = parameter(9, 2, 64, '', 'samples of the image across a box')
    samples_down: int = parameter(
        15, 2, 64, '', 'samples of the image down a box; at least one for each part')
    background_contrast: float = parameter(
        25.0, 0.0, 255.0, 'levels', 'a pixel that differs by less from the learnt background '
        'belongs to no target; 0 as in the paper: every pixel may belong to one')
    background_frames: float = parameter(
        100.0, 1.0, 1e5, 'frames', 'time over which the background is averaged')
    background_updates: int = parameter(
        2, 1, 1000, '', 'updates after which the background is trusted where a target '
        'was marked')
    background_gain: float = parameter(
        0.1, 0.0, 1.0, '', 'further share of the background in the initial box that must become '
        'known before the box is sampled again')
    background_match: float = parameter(
        0.8, 0.0, 1.0, '', 'a target is taken to have been learnt as background if more than this '
        'share of its initial box looks like it; the background there is then discarded')
    adaptation: float = parameter(
        0.0, 0.0, 1.0, '', 'weight of a new frame in the reference, in frames in which the target '
        'is seen; 0 as in the paper')

    start_speed: float = parameter(
        0.1, 0.0, 2.0, '1/frame', 'spread of the initial velocity, per axis')
    velocity_noise: float = parameter(
        0.012, 0.0, 1.0, '1/frame', 'random walk of the velocity, per axis and square root of a '
        'frame; with position_noise it makes sigma_m and sigma_n of eq. 19')
    position_noise: float = parameter(
        0.01, 0.0, 1.0, '', 'scatter of the position, per axis and square root of a frame')
    stop_chance: float = parameter(
        0.03, 0.0, 1.0, '1/frame', 'chance that a target stops; 0 as in the paper')
    start_chance: float = parameter(
        0.03, 0.0, 1.0, '1/frame', 'chance that a standing target starts, with a velocity as '
        'at the start; 0 as in the paper')
    angle_noise_deg: float = parameter(
        2.0, 0.0, 90.0, 'deg', 'sigma_theta of eq. 19, per square root of a frame')
    size_noise: float = parameter(
        0.01, 0.0, 0.5, '', 'random walk of the logarithm of width and height, per square root of '
        'a frame; without the environment')
    size_rate_noise: float = parameter(
        0.002, 0.0, 0.5, '1/frame', 'random walk of the rates of width and height; without the '
        'environment')

    prior_noise: float = parameter(
        0.05, 1e-4, 10.0, '1/frame', 'sigma_e of the environment prior, eq. 20, per frame')
    prior_rounds: int = parameter(
        15, 1, 1000, '', 'maximum number of accept-reject rounds; a candidate not accepted by '
        'then is weighted by its probability of acceptance')
    mark_ratio: float = parameter(
        0.25, 0.01, 1.0, '', "expected height of a target as a share of the camera's height, both "
        'above the ground; it determines the horizon')
    mark_ratio_spread: float = parameter(
        0.5, 0.01, 3.0, '', 'spread of the logarithm of mark_ratio')
    mark_height_spread: float = parameter(
        0.2, 0.01, 2.0, '', 'spread of the logarithm of the heights of the marked targets among '
        'themselves')
    horizon_noise: float = parameter(
        0.003, 0.0, 0.5, '', 'random walk of the logarithm of the distance to the horizon, per '
        'square root of a frame')
    width_spread: float = parameter(
        0.12, 0.0, 1.0, '', 'spread of the log width about the perspective value')
    height_spread: float = parameter(
        0.06, 0.0, 1.0, '', 'spread of the log height about the perspective value')
    spread_frames: float = parameter(
        10.0, 1.0, 1e4, 'frames', 'correlation time of width and height about the perspective')

    covering: bool = parameter(
        True, doc='whether upright targets occlude those behind them; false as in the paper')
    initial_free_share: float = parameter(
        0.2, 0.0, 1.0, '', 'if nearer targets leave less than this share of the foreground in an '
        'initial box free, the box is sampled including them')
    unseen_share: float = parameter(
        0.4, 0.0, 1.0, '', 'similarity assumed for unseen parts, as a share of the '
        'usual one; also the least similarity of any box')
    hidden_evidence: float = parameter(
        0.4, 0.0, 1.0, '', 'a target is occluded when the contrast of its box with the '
        'surroundings is less than this share of its usual value')
    usual_renewal: float = parameter(
        0.05, 0.0, 1.0, '', 'weight of a new frame in the usual values')
    hidden_frames: float = parameter(
        40.0, 0.0, 1e6, 'frames', 'a target occluded for longer is lost')
    least_visible: float = parameter(
        0.35, 0.0, 1.0, '', 'a target has left the view when less than this share of its box is '
        'in the image')
    outside_weight: float = parameter(
        0.5, 0.0, 1.0, '', 'a target has also left the view when more than this weight of its '
        'particles has')

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.samples_down < self.parts:
            raise InputError('configuration', 'samples_down', self.samples_down,
                             f'at least one for each of the {self.parts} parts')

    def with_paper_likelihood(self) -> MonocularConfig:
        """Return the parameters with the paper's likelihood: one fixed histogram."""
        return replace(self, surround_weight=0.0, contrast_weight=0.0, parts=1, adaptation=0.0,
                       background_contrast=0.0, covering=False)
