# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Every number one can set, once: default, unit, bounds and meaning.

The YAML files of ``config/``, the command line and the ROS parameters all derive from here.
"""
from __future__ import annotations

import dataclasses
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any, Mapping, TypeVar, Union

import yaml

from .errors import InputError

Number = Union[int, float]
Config = TypeVar('Config')


def parameter(default: Number, low: Number, high: Number, unit: str, doc: str) -> Any:
    """Make a field of a config record that carries its unit, bounds and meaning."""
    meta = {'low': low, 'high': high, 'unit': unit, 'doc': doc}
    return dataclasses.field(default=default, metadata=meta)


@dataclass(frozen=True)
class TrackerConfig:
    """
    Parameters of the constrained tracker; the paper's values (2012, Section V) by default.

    Deviations of random walks are rates, per square root of a second, so that the frame rate
    does not change the filter; the paper's per-frame values at 5 frames/s are given in each doc.
    """

    particles: int = parameter(400, 20, 20000, '', 'number of particles N')
    speed_rate_std: float = parameter(
        0.335, 0.0, 20.0, 'm/s/sqrt(s)',
        'random walk of the speed; 0.335 is the 0.15 m/s a frame of the paper at 5 frames/s')
    cruise_rate_std: float = parameter(
        0.05, 0.0, 20.0, 'm/s/sqrt(s)', 'random walk of the speed of a vehicle that cruises')
    cruise_share: float = parameter(
        0.7, 0.0, 1.0, '', 'share of passes that cruise; 0 leaves the model out')
    acceleration_std_mps2: float = parameter(
        1.5, 0.0, 20.0, 'm/s^2', 'first acceleration of a vehicle that changes its speed')
    jerk_rate_std: float = parameter(
        3.0, 0.0, 50.0, 'm/s^2/sqrt(s)', 'random walk of the acceleration of such a vehicle')
    manoeuvre_across_std_m: float = parameter(
        1.0, 0.0, 5.0, 'm/sqrt(s)', 'drift across the path of a vehicle that changes lanes, by a '
        'rate that persists')
    manoeuvre_across_s: float = parameter(
        0.5, 0.01, 100.0, 's', 'for about this long')
    manoeuvre_probability: float = parameter(
        0.05, 0.0, 0.49, '', 'share of passes that brake or accelerate, and share of those that '
        'change lanes; 0 leaves these models out')
    drift_across_std_m: float = parameter(
        0.2236, 0.0, 5.0, 'm/sqrt(s)',
        'drift across the path, sigma_P of eq. 27; 0.10 m a frame at 5 frames/s')
    drift_up_std_m: float = parameter(
        0.0671, 0.0, 2.0, 'm/sqrt(s)',
        'drift above the path, sigma_B of eq. 27; 0.03 m a frame at 5 frames/s')
    smooth_ride_std_m: float = parameter(
        0.003, 0.0005, 0.5, 'm', 'bouncing of the front on a smooth ride, and its climbing above '
        'the path in a second')
    rough_ride_std_m: float = parameter(
        0.03, 0.0005, 0.5, 'm', 'the same on a rough ride')
    smooth_share: float = parameter(
        0.5, 0.0, 1.0, '', 'share of passes that ride smoothly')
    parts: int = parameter(10, 4, 16, '', 'parts N_p of the front: 4, 6, 8, 10, 12 or 16')
    samples_per_part: int = parameter(
        8, 4, 16, '', 'samples across and down each part in the refinement; a multiple of 4')
    lambda_d: float = parameter(15.0, 0.0, 1e4, '', 'single-view weight lambda_D of eq. 13')
    lambda_c: float = parameter(20.0, 0.0, 1e4, '', 'cross-view weight lambda_c of eq. 18')
    reference_epsilon: float = parameter(
        0.3, 0.0, 1.0, '', 'share of the old reference kept in each update, epsilon of eq. 14')
    resample_ess: float = parameter(
        0.5, 0.0, 1.0, '', 'resample when the effective sample size falls below this share of N')
    initial_speed_mps: float = parameter(
        20.0, 0.5, 100.0, 'm/s', 'expected speed on a lane without a speed limit')
    initial_speed_std: float = parameter(
        0.5, 0.01, 5.0, '', 'spread of the first speed, as a share of the one expected')

    stamp_std_s: float = parameter(
        2e-4, 0.0, 0.1, 's', '1-sigma of each header stamp against the true exposure')
    trigger_tolerance_s: float = parameter(
        5e-4, 0.0, 1.0, 's', 'pairs whose stamps differ by less were exposed at once; beyond it '
        'each view counts at its own time')
    focal_std: float = parameter(
        5e-4, 0.0, 0.1, '', '1-sigma of the focal lengths, as a share')
    baseline_std_m: float = parameter(
        2e-4, 0.0, 0.1, 'm', '1-sigma of the baseline')
    max_speed_std_share: float = parameter(
        0.01, 0.0, 1.0, '', 'a pass with a greater 1-sigma, as a share of its speed, is rejected')
    max_speed_std_mps: float = parameter(
        0.15, 0.0, 10.0, 'm/s', 'unless its 1-sigma is smaller than this')
    max_scale_std_share: float = parameter(
        0.0025, 0.0, 1.0, '', 'a pass is rejected when focal length, baseline, path and the turn '
        'of the cameras leave its scale this uncertain')
    particle_budget: int = parameter(
        2000, 100, 100000, '', 'particles of all tracks together; many tracks share them')

    def __post_init__(self) -> None:
        check_bounds(self)


def check_bounds(config: Any) -> None:
    """
    Check each field of a config record against its bounds.

    :raises InputError: names the field, what was found and what was wanted.
    """
    for f in dataclasses.fields(config):
        value, meta = getattr(config, f.name), f.metadata
        kind = (int,) if isinstance(f.default, int) else (int, float)
        wanted = f'{kind[-1].__name__} in [{meta["low"]}, {meta["high"]}] {meta["unit"]}'.strip()
        if isinstance(value, bool) or not isinstance(value, kind) or not math.isfinite(value) \
                or not meta['low'] <= value <= meta['high']:
            raise InputError('configuration', f.name, repr(value), wanted)


def load_config(path: Union[str, Path], kind: type[Config] = TrackerConfig) -> Config:
    """
    Read a YAML mapping of parameters; the others keep their defaults.

    :param kind: the config record whose parameters they are, the tracker's if none is told.
    :raises InputError: unreadable file, unknown key or value out of bounds.
    """
    try:
        data = yaml.safe_load(Path(path).read_text(encoding='utf-8'))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(path, 'file', ' '.join(str(error).split()), 'readable YAML') from None
    if not isinstance(data, Mapping):
        raise InputError(path, 'top level', type(data).__name__, 'a mapping of parameters')
    known = [f.name for f in dataclasses.fields(kind)]
    for key in data:
        if key not in known:
            raise InputError(path, 'key', key, 'one of ' + ', '.join(known))
    try:
        return kind(**data)
    except InputError as error:
        raise InputError(path, error.what, error.found, error.wanted) from None


TOLERANCES = ('focal_std', 'baseline_std_m', 'stamp_std_s')  # those that a site file may give


def check_tolerance(name: str, value: Any, where: object) -> float:
    """
    Check a tolerance of a site file against the bounds of its parameter.

    :raises InputError: names the file and the field.
    """
    try:
        return float(getattr(TrackerConfig(**{name: value}), name))
    except InputError as error:
        raise InputError(where, f'tolerances.{name}', error.found, error.wanted) from None
