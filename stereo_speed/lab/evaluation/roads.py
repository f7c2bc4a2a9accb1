# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Random roads, clicked and refined: the errors and uncertainties of speeds on them.

Number and seed determine a road. No vehicle is drawn: the error of a speed follows from path and
rig (:mod:`stereo_speed.site.refine.speed_effect`).
"""
from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Any, Callable, Mapping, Sequence

import numpy as np

from .labeled_sequence import read_back
from .metrics import rms
from .tables import Cell, Table
from ..sim.config import RigConfig, RIGS, RoadConfig, SimConfig
from ..sim.painter import Painter
from ..sim.scene import SimScene
from ..sim.sequence import exact_site, picked_site
from ...batch.job import Job, Result
from ...core.errors import SiteError
from ...core.records import StereoPair
from ...geometry.rig import StereoRig
from ...road.lanes import LanePath
from ...road.path import Path, SplinePath
from ...site.file import load_site
from ...site.lane_paths import lane_paths
from ...site.refine.refiner import refine_site
from ...site.refine.speed_effect import lane_speed_std, Setup, speed_error

PAIRS = 5  # pairs of the empty road
SAME = 5e-4  # share of the speed by which equal errors may differ
_FAR_SIGMAS = 4.0
SMALLER = 0.7  # scale of the images relative to the usual rigs', to save time
_CREST_M = 10.0  # length next to a hidden part that is seen at a grazing angle and left out
_SPACING_M = 1.0  # spacing of the points of a true path
_EVERY_S = 1.0  # time between the pairs
Draw = Callable[[np.random.Generator], RoadConfig]


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _straight(rng: np.random.Generator) -> RoadConfig:
    return RoadConfig(grade=float(rng.uniform(-0.03, 0.03)))


def _steep(rng: np.random.Generator) -> RoadConfig:
    return RoadConfig(grade=_sign(rng) * float(rng.uniform(0.04, 0.08)))


def _bend(rng: np.random.Generator) -> RoadConfig:
    curvature = _sign(rng) * float(rng.uniform(0.004, 0.02))
    return RoadConfig(curvature_start=curvature, curvature_end=curvature)


def _clothoid(rng: np.random.Generator) -> RoadConfig:
    sign = _sign(rng)
    return RoadConfig(curvature_start=sign * 0.002, curvature_end=sign * float(
        rng.uniform(0.015, 0.032)), grade=float(rng.choice([-0.02, 0.02])))


def _hairpin(rng: np.random.Generator) -> RoadConfig:
    curvature = _sign(rng) / float(rng.uniform(16.0, 22.0))
    return RoadConfig(curvature_start=0.2 * curvature, curvature_end=curvature, clothoid_m=20.0,
                      grade=float(rng.uniform(-0.05, 0.05)), lane_width_m=3.2)


def _vertical(rng: np.random.Generator, change: float, road: RoadConfig) -> RoadConfig:
    """Give a road a vertical curve, with grades nearly symmetric about level."""
    middle = float(rng.uniform(-0.01, 0.01))
    return replace(road, grade=middle - change / 2, grade_end=middle + change / 2,
                   vertical_curve_m=float(rng.uniform(30.0, 60.0)),
                   vertical_curve_at_m=float(rng.uniform(15.0, 35.0)))


def _crest(rng: np.random.Generator) -> RoadConfig:
    return _vertical(rng, -float(rng.uniform(0.02, 0.05)), RoadConfig())


def _hiding_crest(rng: np.random.Generator) -> RoadConfig:
    return replace(_vertical(rng, -float(rng.uniform(0.12, 0.16)), RoadConfig()),
                   vertical_curve_at_m=float(rng.uniform(8.0, 20.0)))


def _sag(rng: np.random.Generator) -> RoadConfig:
    return _vertical(rng, float(rng.uniform(0.03, 0.08)), RoadConfig())


def _banked(rng: np.random.Generator) -> RoadConfig:
    sign, curvature = _sign(rng), float(rng.uniform(0.008, 0.02))
    return RoadConfig(
        curvature_start=0.1 * sign * curvature, curvature_end=sign * curvature,
        grade=float(rng.uniform(-0.04, 0.04)), crossfall_start=0.02 * sign * float(
            rng.choice([-1.0, 1.0])), crossfall_end=-sign * float(rng.uniform(0.04, 0.08)))


def _run_off(rng: np.random.Generator) -> RoadConfig:
    """Return the entry or the exit of a bend, with at least one kink of its crossfall in view."""
    sign, curvature = _sign(rng), float(rng.uniform(0.008, 0.02))
    plain = sign * float(rng.choice([-0.025, 0.025])), 0.0
    banked = -sign * float(rng.uniform(0.04, 0.08)), sign * curvature
    (fall, bend), (fall_end, bend_end) = (
        (plain, banked) if rng.uniform() < 0.5 else (banked, plain))
    length_m = float(rng.uniform(20.0, 40.0))
    begin_m = float(rng.uniform(4.0, 20.0))
    if rng.uniform() < 0.5:  # the run-off ends in view, rather than begins
        begin_m -= length_m
    return RoadConfig(
        curvature_start=bend, curvature_end=bend_end, clothoid_m=length_m, clothoid_at_m=begin_m,
        crossfall_start=fall, crossfall_end=fall_end, grade=float(rng.uniform(-0.04, 0.04)))


def _crest_bend(rng: np.random.Generator) -> RoadConfig:
    return _vertical(rng, -float(rng.uniform(0.04, 0.12)), _bend(rng))


def _worn(rng: np.random.Generator) -> RoadConfig:
    return replace(_straight(rng), wear=float(rng.uniform(0.3, 0.6)))


def _dashed(rng: np.random.Generator) -> RoadConfig:
    road = _bend(rng) if rng.uniform() < 0.5 else _sag(rng)
    return replace(road, dashed_edges=True, wear=float(rng.uniform(0.0, 0.3)))


KINDS: dict[str, Draw] = {
    'straight': _straight, 'steep grade': _steep, 'bend': _bend, 'clothoid, 2 %': _clothoid,
    'hairpin': _hairpin, 'crest': _crest, 'crest that hides': _hiding_crest, 'sag': _sag,
    'banked bend': _banked, 'bend over a crest': _crest_bend, 'worn lines': _worn,
    'dashed lines': _dashed}
RUN_OFF = 'bend with run-off'  # kind of road whose superelevation is built up in view


@dataclass(frozen=True, kw_only=True)
class RandomRoad:
    """
    A random road.

    :param kind: one of ``KINDS``.
    :param config: its configuration; its vehicle only determines where the camera looks.
    :param clicks_on: whether the clicks continue where a crest hides the lines.
    """

    kind: str
    config: SimConfig
    clicks_on: bool


def draw_road(seed: int, number: int, pan_deg: float = 0.0, run_off: bool = False) -> RandomRoad:
    """
    Draw a road; kinds take turns.

    :param seed: seed of the whole set.
    :param number: number of the road in the set, from 0.
    :param pan_deg: rotation of the right camera to either side since its calibration.
    :param run_off: whether to draw a bend with a run-off instead.
    """
    kind = RUN_OFF if run_off else list(KINDS)[number % len(KINDS)]
    rng = np.random.default_rng([seed, number])
    road = _run_off(rng) if run_off else KINDS[kind](rng)
    road = replace(road, lanes=int(rng.integers(1, 4)) if kind != 'hairpin' else 2)
    if run_off:  # turned about its right edge, its middle or its left edge
        about = float(rng.choice([0.0, 0.5, 1.0]))
        road = replace(road, turned_about_m=(about * road.lanes - 0.5) * road.lane_width_m)
    straight = not (road.curvature_start or road.curvature_end)
    rig = list(RIGS)[(number // len(KINDS)) % len(RIGS)]
    start_m = float(rng.uniform(60, 75) if straight else rng.uniform(44, 50))
    config = SimConfig(
        road=road, rig=_smaller(RIGS[rig]), start_m=start_m,
        near_m=float(rng.uniform(15, 18)), camera_height_m=float(rng.uniform(2.5, 6.0)),
        camera_side_m=float(rng.uniform(3.0, 6.0)) if straight else None,
        noise_grey=float(rng.uniform(1.0, 3.0)), name=f'road {number}',
        rig_moved_deg=(_sign(rng) * pan_deg, 0.0, 0.0))
    if kind == 'hairpin':
        config = replace(config, start_m=34.0, near_m=14.0, rig=replace(
            config.rig, f_px=SMALLER * 1300.0, right_f_px=None))
    return RandomRoad(kind=kind, config=config, clicks_on=bool((number // len(KINDS)) % 2))


def _smaller(rig: RigConfig) -> RigConfig:
    """Return a rig with fewer pixels for the same field of view."""
    return replace(rig, width_px=round(SMALLER * rig.width_px),
                   height_px=round(SMALLER * rig.height_px), f_px=SMALLER * rig.f_px,
                   right_f_px=None if rig.right_f_px is None else SMALLER * rig.right_f_px)


def road_jobs(count: int, seed: int, pan_deg: float, run_off: bool = False) -> list[Job]:
    """Return a job for each road; its parameters are everything that its result depends on."""
    return [Job(key=f'{number:03d}', parameters={
        'seed': seed, 'number': number, 'pan_deg': pan_deg, 'run_off': run_off})
        for number in range(count)]


def measure_road(parameters: Mapping[str, Any]) -> Mapping[str, Any]:
    """
    Draw, click and refine one road.

    :param parameters: parameters of a job of :func:`road_jobs`.
    :return: errors and 1-sigmas of speeds on the worst lane, as shares, clicked and refined; and
        the messages of the refinement.
    """
    drawn = draw_road(**parameters)
    scene = SimScene(drawn.config)
    rng = np.random.default_rng([parameters['seed'], parameters['number'], 1])
    pick, scenery, bodies = rng.spawn(3)
    site = read_back(picked_site(scene, pick, hidden=drawn.clicks_on), load_site)
    exact = true_paths(scene)
    out: dict[str, Any] = {'kind': drawn.kind}
    try:
        clicks = lane_paths(site, scene.rig)
    except SiteError as error:
        clicks = {}
        out['clicks_refused'] = str(error)
    painter = Painter(scene, scenery, bodies)
    pairs = [StereoPair(i, i, i, *painter.paint((), i * _EVERY_S)[0]) for i in range(PAIRS)]
    try:
        refined = refine_site(site, scene.rig, pairs)
    except SiteError as error:
        return {**out, **_worst(scene, exact, {'clicks': (clicks, scene.rig)}),
                'refined_refused': str(error)}
    pan_deg, tilt_deg, roll_deg = np.degrees(refined.drift.drift_rad)
    out.update(_worst(scene, exact, {'clicks': (clicks, scene.rig),
                                     'refined': (refined.lanes, refined.rig)}))
    return {**out, 'turned': bool(refined.drift.moved), 'pan_deg': float(pan_deg),
            'tilt_deg': float(tilt_deg), 'roll_deg': float(roll_deg),
            'moved_probability': refined.drift.moved_probability, 'lost': list(refined.lost),
            'kept_clicks': refined.kept_clicks}


def true_paths(scene: SimScene) -> dict[str, Path]:
    """Return the true path of each lane, without the part hidden by a crest."""
    out: dict[str, Path] = {}
    for name, lane in lane_paths(read_back(exact_site(scene), load_site), scene.seen_rig).items():
        s = np.linspace(0.0, lane.path.length_m, round(lane.path.length_m / _SPACING_M))
        points = lane.path.position(s)
        hidden = np.flatnonzero(~scene.open_m(points))
        first = 0 if not len(hidden) else min(
            int(hidden[-1]) + round(_CREST_M / _SPACING_M), len(points) - 2)
        out[name] = SplinePath(points[first:], lane.path.frame(s[first:])[..., 2])
    return out


def _worst(scene: SimScene, exact: Mapping[str, Path],
           used: Mapping[str, tuple[Mapping[str, LanePath], StereoRig]]) -> dict[str, float]:
    """Return error and 1-sigma of each method on the lane with the last one's greatest error."""
    best: dict[str, float] = {}
    for name, truth in exact.items():
        here = {}
        for way, (lanes, rig) in used.items():
            if name in lanes:
                lane = lanes[name]
                here[f'{way}_error'] = speed_error(
                    Setup(truth, scene.seen_rig), Setup(lane.path, rig))
                here[f'{way}_std'] = lane_speed_std(lane, rig)
        key = f'{list(used)[-1]}_error'
        if not best or abs(here.get(key, 0.0)) > abs(best.get(key, 0.0)):
            best = here
    return best


def road_table(results: Sequence[Result]) -> Table:
    """Return a row for each road, errors and 1-sigmas in percent of the speed."""
    rows = []
    for result in results:
        v = result.value or {}
        said = v.get('refined_refused') or v.get('kept_clicks') or ''
        rows.append([
            result.key, v.get('kind', 'failed'), *(
                None if v.get(key) is None else 100 * v[key] for key in (
                    'clicks_error', 'clicks_std', 'refined_error', 'refined_std')),
            v.get('moved_probability'), v.get('pan_deg'), said])
    return Table(title='', rows=rows, digits=(0, 0, 3, 3, 3, 3, 3, 4, 0), columns=(
        'road', 'kind', 'clicks, %', 'σ', 'refined, %', 'σ', 'probability of a turn',
        'pan corrected, °', 'reason if not refined'))


def kinds_table(results: Sequence[Result]) -> Table:
    """Return a row for all roads and one for each kind of them, in percent of the speed."""
    values = [r.value for r in results if r.value is not None]
    rows: list[list[Cell]] = []
    for kind in ('all', *KINDS, RUN_OFF):
        mine = [v for v in values if kind in ('all', v['kind'])]
        if mine:
            rows.append([kind, len(mine), *_figures(mine)])
    return Table(title='', rows=rows, columns=(
        '', 'roads', 'clicks, r.m.s. error, %', 'refined, r.m.s. error, %', 'worst, %',
        'r.m.s. of error/σ', 'beyond 4 σ', 'worse than the clicks', 'found turned',
        'not refined'), digits=(0, 0, 3, 3, 3, 2, 0, 0, 0, 0))


def _figures(values: Sequence[Mapping[str, Any]]) -> list[Cell]:
    """Return the cells of a row of :func:`kinds_table` for some roads."""
    clicks = np.array([100 * v['clicks_error'] for v in values
                       if v.get('clicks_error') is not None])
    refined = [v for v in values if v.get('refined_error') is not None]
    errors = np.array([100 * v['refined_error'] for v in refined])
    scores = np.array([v['refined_error'] / v['refined_std'] for v in refined])
    return [rms(clicks), rms(errors), np.abs(errors).max(initial=0.0), rms(scores),
            int(np.sum(np.abs(scores) > _FAR_SIGMAS)), sum(map(_is_worse, refined)),
            sum(bool(v.get('turned')) for v in refined), len(values) - len(refined)]


def _is_worse(value: Mapping[str, Any]) -> bool:
    """Return whether the refined road is worse than the clicked one."""
    return bool(abs(value['refined_error'])
                > abs(value.get('clicks_error', math.inf)) + SAME)


def road_figures(results: Sequence[Result]) -> str:
    """Return a summary of the roads in one sentence."""
    values = [r.value for r in results if r.value is not None]
    refined = [v for v in values if 'refined_error' in v]
    worse = sum(map(_is_worse, refined))
    scores = [v['refined_error'] / v['refined_std'] for v in refined]
    return (f'{len(values)} roads: {len(refined)} refined, {len(values) - len(refined)} refused, '
            f'{sum(bool(v.get("kept_clicks")) for v in refined)} kept as clicked, '
            f'{sum(v["turned"] for v in refined)} found turned, {worse} worse than the clicks; '
            f'r.m.s. of error/σ {rms(np.array(scores)):.2f}' if refined
            else f'{len(values)} roads: none refined')
