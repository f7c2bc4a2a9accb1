# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A simulated sequence: pairs, rig, site, initial fronts and truth."""
from __future__ import annotations

from dataclasses import dataclass
from typing import Mapping, Optional, Sequence, TypedDict, Union

import numpy as np
from numpy.typing import NDArray

from .config import SimConfig
from .painter import Painter
from .scene import Exposure, SimScene, TruthRow
from .sway import Sway
from ...core.errors import InputError
from ...core.records import Array, RigMotion, StereoPair
from ...geometry.rig import StereoRig

MOST_PAIRS = 2000
EXACT_STD_M = 1e-4  # 1-sigma of the true lines
PICK_BEYOND_M = 5.0  # the picks start this far beyond the first front

Points = list[list[float]]


class SiteLane(TypedDict):
    """A lane in a site file."""

    name: str
    right: str
    left: str
    speed_limit: str


class SiteContent(TypedDict):
    """Content of a site file; points of each line by name and by the key of their kind."""

    stereo_speed_site: int
    name: str
    lines: Mapping[str, Mapping[str, Union[Points, float]]]
    lanes: list[SiteLane]


class InitFront(TypedDict):
    """The front of a vehicle in an init file."""

    frame: int
    left_image: Points
    right_image: Points


class InitContent(TypedDict):
    """Content of an init file."""

    stereo_speed_init: int
    vehicles: list[InitFront]


@dataclass(frozen=True, eq=False)
class SimSequence:
    """
    The result of a simulation.

    :param config: its configuration.
    :param scene: its geometry.
    :param rig: the calibrated rig: the true one unless ``rig_moved_deg`` says otherwise.
    :param site: content of a site file with picked lines.
    :param site_exact: content of a site file with the true lines as ``points_m``.
    :param init: content of an init file.
    :param pairs: the pairs, numbered from 0.
    :param truth: rows of ``truth.csv``, one for each vehicle and pair, each with ``stamp_ns``.
    """

    config: SimConfig
    scene: SimScene
    rig: StereoRig
    site: SiteContent
    site_exact: SiteContent
    init: InitContent
    pairs: tuple[StereoPair, ...]
    truth: tuple[TruthRow, ...]


def simulate(config: SimConfig, rng: np.random.Generator) -> SimSequence:
    """
    Make a sequence; the same config and generator state give the same one.

    :param config: its configuration.
    :param rng: source of textures, noise, jitter and scatter.
    :raises InputError: no vehicle is ever completely in both views.
    """
    # One generator per purpose, so that more pairs or picks change nothing else.
    vehicle, scenery, clock, pick, init, wind = rng.spawn(6)
    scene = SimScene(config)
    exposures = _exposures(scene, clock)
    sway = Sway(config, wind)
    motions = [sway.motion(taken.t_s) for taken in exposures]
    painter = Painter(scene, scenery, vehicle)
    pairs: list[StereoPair] = []
    truth: list[TruthRow] = []
    for index, (taken, motion) in enumerate(zip(exposures, motions)):
        (left, right), _ = painter.paint(scene.vehicles, taken.t_s, motion)
        pairs.append(StereoPair(index, taken.stamp_ns, taken.right_stamp_ns, left, right))
        truth += [scene.truth(v, taken.t_s, taken.stamp_ns) for v in scene.vehicles
                  if scene.visible(v, taken.t_s)]
    return SimSequence(
        config, scene, scene.rig, picked_site(scene, pick), exact_site(scene),
        initial_fronts(scene, [taken.t_s for taken in exposures], init, motions), tuple(pairs),
        tuple(truth))


def _exposures(scene: SimScene, rng: np.random.Generator) -> list[Exposure]:
    """Return the exposures until the last vehicle has left the view."""
    out: list[Exposure] = []
    seen = False
    for taken in scene.exposures(min(scene.config.pairs or MOST_PAIRS, MOST_PAIRS), rng):
        visible = any(scene.visible(vehicle, taken.t_s) for vehicle in scene.vehicles)
        if seen and not visible:
            break
        seen = seen or visible
        out.append(taken)
    if not seen:
        raise InputError('simulation', 'vehicles', 'none whole in both views',
                         'a start and camera that see the front')
    return out


def _line_points(scene: SimScene, offset_m: float, step_m: float) -> Array:
    """Return points (n, 3) of a line in the left frame, from far to near."""
    road = scene.road
    last = scene.end_station_m + scene.config.near_m + 10.0
    stations = np.arange(max(-PICK_BEYOND_M, road.from_m), min(last, road.to_m), step_m)
    return scene.point(stations, np.full_like(stations, offset_m))


def _visible_run(uv: Array, valid: NDArray[np.bool_]) -> Array:
    """Return the longest run of points inside the image."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], valid.astype(int), [0]])))
    runs = edges.reshape(-1, 2)
    if not len(runs):
        return uv[:0]
    start, stop = runs[np.argmax(runs[:, 1] - runs[:, 0])]
    return uv[start:stop]


def _picks(uv: Array, count: int, std_px: float, rng: np.random.Generator) -> Points:
    """Pick points approximately evenly along a curve of pixels (n, 2), with scatter."""
    if len(uv) < 2:
        return []
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(uv, axis=0), axis=1))])
    place = (np.arange(count) + rng.uniform(0.1, 0.9)) / count * arc[-1]
    points = np.stack([np.interp(place, arc, uv[:, k]) for k in (0, 1)], axis=1)
    points += rng.standard_normal(points.shape) * std_px
    return _rounded(points)


def _rounded(points: Array, decimals: int = 2) -> Points:
    """Return points in the form of a file."""
    return [[round(float(x), decimals) for x in point] for point in points]


def site_lines(scene: SimScene) -> tuple[dict[str, tuple[float, bool]], list[tuple[str, str]]]:
    """
    Name the lines of a site, each in order along travel.

    A line between lanes of opposite directions occurs twice, once in each order.

    :return: offset of each line and whether it runs away from the camera, by name; and the names
        of the right and the left line of each lane.
    """
    road = scene.road
    away = road.config.receding
    names, offsets = list(road.line_offsets()), road.line_offsets()
    lines: dict[str, tuple[float, bool]] = {}
    lanes = []
    for i in range(road.config.lanes):
        pair = [names[i + 1], names[i]] if i in away else [names[i], names[i + 1]]
        # A line shared with a lane of the other direction gets a separate name.
        shared = {names[i + k] for k, j in ((0, i - 1), (1, i + 1))
                  if i in away and 0 <= j < road.config.lanes and j not in away}
        own = [name + '_away' if name in shared else name for name in pair]
        for name, source in zip(own, pair):
            lines.setdefault(name, (offsets[source], i in away))
        lanes.append((own[0], own[1]))
    return lines, lanes


def _site(scene: SimScene, lines: Mapping[str, Mapping[str, Union[Points, float]]]) -> SiteContent:
    lanes: list[SiteLane] = [
        {'name': f'lane_{i}', 'right': right, 'left': left,
         'speed_limit': scene.config.speed_limit}
        for i, (right, left) in enumerate(site_lines(scene)[1])]
    return {'stereo_speed_site': 1, 'name': scene.config.name, 'lines': lines, 'lanes': lanes}


def picked_site(scene: SimScene, rng: np.random.Generator, *, hidden: bool = True
                ) -> SiteContent:
    """
    Pick points of the lines, independently in each view.

    :param scene: the scene.
    :param rng: source of the scatter.
    :param hidden: whether to pick also where a crest hides the line.
    """
    config = scene.config
    lines: dict[str, dict[str, Points]] = {}
    picks: dict[float, tuple[Points, Points]] = {}
    for name, (offset, away) in site_lines(scene)[0].items():
        if offset not in picks:
            points = _line_points(scene, offset, 0.02)
            left, right, in_left, in_right = scene.seen_rig.project(points)
            if not hidden:
                in_left, in_right = in_left & scene.open_m(points), in_right & scene.open_m(points)
            picks[offset] = (
                _picks(_visible_run(left, in_left), config.picks, config.pick_std_px, rng),
                _picks(_visible_run(right, in_right), config.picks, config.pick_std_px, rng))
        order = -1 if away else 1
        lines[name] = {key: line[::order] for key, line in zip(
            ('left_image', 'right_image'), picks[offset])}
    return _site(scene, lines)


def exact_site(scene: SimScene) -> SiteContent:
    """Return the same site with the true lines as points, 6 decimals."""
    return _site(scene, {
        name: {'points_m': _rounded(_line_points(scene, offset, 1.0)[::-1 if away else 1], 6),
               'std_m': EXACT_STD_M}
        for name, (offset, away) in site_lines(scene)[0].items()})


def initial_fronts(scene: SimScene, times_s: list[float], rng: np.random.Generator,
                   motions: Optional[Sequence[Optional[RigMotion]]] = None) -> InitContent:
    """
    Annotate each vehicle's front in the first pair that shows it completely.

    :param scene: the scene.
    :param times_s: exposure times of the pairs.
    :param rng: source of the scatter.
    :param motions: rig motion in each pair; None for a rig at rest.
    """
    vehicles: list[InitFront] = []
    for vehicle in scene.vehicles:
        frame = next((i for i, t in enumerate(times_s) if scene.visible(vehicle, t)), None)
        if frame is None:
            continue
        corners = scene.front(vehicle, times_s[frame]).corners_m
        rig = scene.seen_rig.as_taken(None if motions is None else motions[frame])
        left, right = (_rounded(uv + rng.standard_normal((4, 2)) * scene.config.init_std_px)
                       for uv in rig.project(corners)[:2])
        vehicles.append({'frame': frame, 'left_image': left, 'right_image': right})
    return {'stereo_speed_init': 1, 'vehicles': vehicles}
