# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""Every parameter of a baseline can be set, changes the result, and runs at its bounds."""
from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from stereo_speed.core.errors import InputError
from stereo_speed.core.tracker_config import TrackerConfig
from stereo_speed.lab.baselines.settings import FlowSettings, PointSettings
from stereo_speed.lab.sim.config import RigConfig, straight_config
from stereo_speed.lab.sim.sequence import simulate
from stereo_speed.pipeline.assembly import make_pipeline
from stereo_speed.pipeline.config import load_pipeline_config, PipelineConfig
from stereo_speed.pipeline.registry import TRACKERS
from stereo_speed.pipeline.run import run
from stereo_speed.site.file import load_site
from stereo_speed.site.init_file import load_init
from stereo_speed.site.lane_paths import lane_paths
import yaml

# Further settings with which a parameter matters in such a short pass.
NEEDED = {'jolt_std_m': {'most_distance2': 0.01}}
BASELINES = [name for name in TRACKERS.own if name != 'constrained']
PARAMETERS = [(name, f.name) for name in BASELINES
              for f in fields(TRACKERS.load(name).Settings)]
EACH = pytest.mark.parametrize(('name', 'parameter'), PARAMETERS,
                               ids=[f'{n}.{p}' for n, p in PARAMETERS])


@pytest.fixture(scope='module')
def measured(tmp_path_factory):
    """Run a baseline over three pairs of small images; return all its figures."""
    small = RigConfig(width_px=400, height_px=300, f_px=600.0)
    sequence = simulate(straight_config('45 mph', rig=small, start_m=26.0, near_m=12.0, pairs=3),
                        np.random.default_rng(4))
    files = [tmp_path_factory.mktemp('site') / name for name in ('site.yaml', 'init.yaml')]
    for path, data in zip(files, (sequence.site_exact, sequence.init)):
        path.write_text(yaml.safe_dump(dict(data)))
    lanes, annotations = lane_paths(load_site(files[0]), sequence.rig), load_init(files[1])

    def figures(name, settings):
        config = PipelineConfig(TrackerConfig(particles=60), name, trackers={name: settings})
        done = run(make_pipeline(sequence.rig, lanes, config, annotations), sequence.pairs)
        result, = done.passes
        return ([(u.state, u.speed_mps, u.speed_std_mps, *u.position_m) for u in done.updates],
                result.speed_mps, result.speed_std_mps, result.reason)
    return figures


@pytest.fixture(scope='module')
def usual(measured):
    """Return the figures of each baseline with the defaults."""
    return {name: measured(name, TRACKERS.load(name).Settings()) for name in BASELINES}


def bounds(name, parameter):
    """Return the settings with a parameter at each bound that is not its default."""
    kind = TRACKERS.load(name).Settings
    meta = next(f for f in fields(kind) if f.name == parameter).metadata
    settings = [kind(**{parameter: type(getattr(kind(), parameter))(meta[side])})
                for side in ('high', 'low')]
    return [found for found in settings if found != kind()]


@pytest.mark.slow
@EACH
def test_every_parameter_changes_something(name, parameter, measured, usual):
    kind = TRACKERS.load(name).Settings
    needed = NEEDED.get(parameter, {})
    before = measured(name, kind(**needed)) if needed else usual[name]
    assert any(measured(name, replace(settings, **needed)) != before
               for settings in bounds(name, parameter))


@pytest.mark.slow
@pytest.mark.parametrize('side', ['low', 'high'])
@pytest.mark.parametrize('name', BASELINES)
def test_all_parameters_run_at_their_bounds(name, side, measured, usual):
    kind = TRACKERS.load(name).Settings
    settings = kind(**{f.name: type(f.default)(f.metadata[side]) for f in fields(kind)})
    updates, speed, std, _ = measured(name, settings)
    assert len(updates) == len(usual[name][0])
    assert np.isfinite(np.array([u[1:] for u in updates])).all()
    assert speed is None or np.isfinite([speed, std]).all()


@EACH
def test_every_parameter_can_be_set_in_a_file(name, parameter, tmp_path):
    wanted = bounds(name, parameter)[0]
    path = tmp_path / 'parameters.yaml'
    values = {parameter: getattr(wanted, parameter)}
    path.write_text(yaml.safe_dump({'trackers': {name: values}}))
    assert load_pipeline_config(path, tracker=name).tracker_settings == wanted


def test_out_of_bounds_values_are_refused():
    with pytest.raises(InputError, match='least_points.*2.*int in .3, 1000.'):
        PointSettings(least_points=2)
    with pytest.raises(InputError, match='match_std_px'):
        replace(FlowSettings(), match_std_px=0.0)


def test_flow_matches_more_precisely_than_sift():
    assert FlowSettings().match_std_px < PointSettings().match_std_px
