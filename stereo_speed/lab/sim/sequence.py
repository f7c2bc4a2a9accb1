# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""A simulated sequence: pairs, rig, site, marks and truth."""
from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from .appearance import BODIES, BodyLook
from .config import SimConfig
from .painter import Painter, Shown
from .render import draw_body, draw_front, VehicleLook
from .scene import SimScene
from .scenery import render_background
from .texture import Image
from .view import rig_views, View
from ...core.errors import InputError
from ...core.records import Array, StereoPair
from ...geometry.rig import StereoRig

Pictures = tuple[NDArray[np.uint8], NDArray[np.uint8]]
Draw = Callable[[float], Pictures]

MOST_PAIRS = 2000
PICK_BEYOND_M = 5.0  # the picks begin this far before the first front


@dataclass(frozen=True, eq=False)
class SimSequence:
    """
    What a simulation gives.

    :param config: what it was made from.
    :param scene: the geometry behind it.
    :param rig: the calibrated rig: the true one unless ``rig_moved_deg`` says otherwise.
    :param site: content of a site file with picked lines.
    :param site_exact: content of a site file with the true lines as ``points_m``.
    :param init: content of an init file.
    :param pairs: the pairs, numbered from 0.
    :param truth: rows of ``truth.csv``, one for each vehicle and pair, and ``stamp_ns`` in each.
    """

    config: SimConfig
    scene: SimScene
    rig: StereoRig
    site: Mapping[str, Any]
    site_exact: Mapping[str, Any]
    init: Mapping[str, Any]
    pairs: tuple[StereoPair, ...]
    truth: tuple[Mapping[str, Any], ...]


def simulate(config: SimConfig, rng: np.random.Generator) -> SimSequence:
    """
    Make a sequence; the same config and generator state give the same one.

    :param config: what to simulate.
    :param rng: source of textures, noise, jitter and scatter.
    :raises InputError: when no vehicle is ever whole in both views.
    """
    # A generator for each purpose, so that more pairs or picks change nothing else.
    texture, noise, clock, pick, mark = rng.spawn(5)
    scene = SimScene(config)
    times = _times(scene, clock)
    if not times:
        raise InputError('simulation', 'vehicles', 'none whole in both views',
                         'a start and camera that see the front')
    pairs: list[StereoPair] = []
    truth: list[Mapping[str, Any]] = []
    draw = _staged(scene, texture, noise) if config.staged else _plain(scene, texture, noise)
    for t_s, stamp_ns, right_stamp_ns in times:
        left, right = draw(t_s)
        pairs.append(StereoPair(len(pairs), stamp_ns, right_stamp_ns, left, right))
        truth += [scene.truth(i, t_s, stamp_ns) for i, vehicle in enumerate(config.vehicles)
                  if scene.visible(vehicle, t_s)]
    return SimSequence(
        config, scene, scene.rig, picked_site(scene, pick), exact_site(scene),
        marks(scene, [t[0] for t in times], mark), tuple(pairs), tuple(truth))


def _plain(scene: SimScene, texture: np.random.Generator,
           noise: np.random.Generator) -> Draw:
    """Draw plain bodies over the road."""
    config, views = scene.config, rig_views(scene.seen_rig)
    backgrounds = render_background(scene, views, texture)
    looks = [VehicleLook(vehicle, texture) for vehicle in config.vehicles]

    def draw(t_s: float) -> Pictures:
        images = [_draw(scene, view, looks, background, t) for view, background, t in
                  zip(views, backgrounds, (t_s, t_s + config.right_delay_s))]
        images[1] = images[1] * config.right_gain + config.right_offset_grey
        left, right = (_expose(image, config, noise) for image in images)
        return left, right
    return draw


def _staged(scene: SimScene, texture: np.random.Generator,
            noise: np.random.Generator) -> Draw:
    """Draw textured bodies, and what stands and walks beside the road."""
    config = scene.config
    painter = Painter(scene, noise)
    looks = [BodyLook(replace(
        BODIES[v.kind or 'car'], width_m=v.front_width_m, face_m=v.front_height_m,
        rear_m=v.front_height_m, clearance_m=v.clearance_m), scene.away(v), texture)
        for v in config.vehicles]

    def shown(t_s: float) -> list[Shown]:
        return [Shown(i, look, scene.front(vehicle, t_s))
                for i, (vehicle, look) in enumerate(zip(config.vehicles, looks))]

    def draw(t_s: float) -> Pictures:
        late_s = t_s + config.right_delay_s
        return painter.paint(shown(t_s), (t_s, late_s), shown(late_s))[0]
    return draw


def _times(scene: SimScene, rng: np.random.Generator) -> list[tuple[float, int, int]]:
    """Return exposure time, s, left and right stamp, ns, of each pair that arrives."""
    config, out, seen = scene.config, [], False
    for i in range(min(config.pairs or MOST_PAIRS, MOST_PAIRS)):
        jitter = float(rng.standard_normal()) * config.stamp_jitter_s if i else 0.0
        # Never more than a third of a period, so that the order is kept.
        jitter = float(np.clip(jitter, -1 / (3 * config.fps), 1 / (3 * config.fps)))
        skew = float(rng.uniform(-1, 1)) * config.right_stamp_jitter_s
        # Whole microseconds, so that truth.csv tells them exactly.
        offset_ns = round((i / config.fps + jitter) * 1e6) * 1000
        t_s = offset_ns * 1e-9
        visible = any(scene.visible(vehicle, t_s) for vehicle in config.vehicles)
        if seen and not visible:
            break
        seen = seen or visible
        if i not in config.drop and not any(a <= t_s < b for a, b in config.gaps_s):
            stamp_ns = config.origin_ns + offset_ns
            late_s = config.right_delay_s + skew
            out.append((t_s, stamp_ns, stamp_ns + round(late_s * 1e9)))
    return out if seen else []


def _draw(scene: SimScene, view: View, looks: list[VehicleLook], background: Image,
          t_s: float) -> Image:
    """Draw the vehicles, the farthest first, over a copy of the background."""
    image = background.copy()
    poses = [(scene.front(look.config, t_s), look) for look in looks]
    for pose, look in sorted(poses, key=lambda p: -p[0].centre_m[2]):
        if pose.corners_m[:, 2].min() < 3.0:
            continue
        if look.config.body:
            draw_body(image, view, look, pose)
        draw_front(image, view, look, pose)
    return image


def _expose(image: Image, config: SimConfig, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Turn the ideal image into 8-bit counts with sensor noise."""
    grain = rng.standard_normal(image.shape, dtype=np.float32) * config.noise_grey
    return np.clip(np.rint(image * config.exposure + grain), 0, 255).astype(np.uint8)


def _line_points(scene: SimScene, offset_m: float, step_m: float) -> Array:
    """Return points (n, 3) of a painted line in the left frame, far to near."""
    road = scene.road
    last = scene.end_station_m + scene.config.near_m + 10.0
    stations = np.arange(max(-PICK_BEYOND_M, road.from_m), min(last, road.to_m), step_m)
    return scene.to_left(road.position(stations, np.full_like(stations, offset_m)))


def _visible_run(uv: Array, valid: Array) -> Array:
    """Return the longest run of points inside the image."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], valid.astype(int), [0]])))
    runs = edges.reshape(-1, 2)
    if not len(runs):
        return uv[:0]
    start, stop = runs[np.argmax(runs[:, 1] - runs[:, 0])]
    return uv[start:stop]


def _picks(uv: Array, count: int, std_px: float, rng: np.random.Generator) -> list[list[float]]:
    """Pick about evenly along a curve of pixels (n, 2), with scatter."""
    if len(uv) < 2:
        return []
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(uv, axis=0), axis=1))])
    place = (np.arange(count) + rng.uniform(0.1, 0.9)) / count * arc[-1]
    points = np.stack([np.interp(place, arc, uv[:, k]) for k in (0, 1)], axis=1)
    points += rng.standard_normal(points.shape) * std_px
    return [[round(float(u), 2), round(float(v), 2)] for u, v in points]


def site_lines(scene: SimScene) -> tuple[dict[str, tuple[float, bool]], list[tuple[str, str]]]:
    """
    Name the lines of a site, each in order along travel.

    A line between lanes of both directions is there twice, once in each order.

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
        # The line towards a lane of the other direction gets a name of its own.
        shared = {names[i + k] for k, j in ((0, i - 1), (1, i + 1))
                  if i in away and 0 <= j < road.config.lanes and j not in away}
        own = [name + '_away' if name in shared else name for name in pair]
        for name, source in zip(own, pair):
            lines.setdefault(name, (offsets[source], i in away))
        lanes.append((own[0], own[1]))
    return lines, lanes


def _site(scene: SimScene, lines: dict[str, Any]) -> dict[str, Any]:
    lanes = [{'name': f'lane_{i}', 'right': right, 'left': left,
              'speed_limit': scene.config.speed_limit}
             for i, (right, left) in enumerate(site_lines(scene)[1])]
    return {'stereo_speed_site': 1, 'name': scene.config.name, 'lines': lines, 'lanes': lanes}


def picked_site(scene: SimScene, rng: np.random.Generator) -> dict[str, Any]:
    """
    Pick the painted lines, in each view on its own.

    :param scene: the scene.
    :param rng: source of the scatter.
    """
    config, lines = scene.config, {}
    picks: dict[float, tuple[list[list[float]], list[list[float]]]] = {}
    for name, (offset, away) in site_lines(scene)[0].items():
        if offset not in picks:
            points = _line_points(scene, offset, 0.02)
            left, right, in_left, in_right = scene.seen_rig.project(points)
            picks[offset] = (
                _picks(_visible_run(left, in_left), config.picks, config.pick_std_px, rng),
                _picks(_visible_run(right, in_right), config.picks, config.pick_std_px, rng))
        order = -1 if away else 1
        lines[name] = {key: line[::order] for key, line in zip(
            ('left_image', 'right_image'), picks[offset])}
    return _site(scene, lines)


def exact_site(scene: SimScene) -> dict[str, Any]:
    """Return the same site with the true lines as points, 6 decimals."""
    return _site(scene, {
        name: {'points_m': [[round(float(x), 6) for x in point]
                            for point in _line_points(scene, offset, 1.0)[::-1 if away else 1]]}
        for name, (offset, away) in site_lines(scene)[0].items()})


def marks(scene: SimScene, times_s: list[float], rng: np.random.Generator) -> dict[str, Any]:
    """
    Mark each vehicle's front in the first pair that shows all of it.

    :param scene: the scene.
    :param times_s: exposure times of the pairs.
    :param rng: source of the scatter.
    """
    vehicles = []
    for vehicle in scene.config.vehicles:
        frame = next((i for i, t in enumerate(times_s) if scene.visible(vehicle, t)), None)
        if frame is None:
            continue
        corners = scene.front(vehicle, times_s[frame]).corners_m
        quads = [uv + rng.standard_normal((4, 2)) * scene.config.init_std_px
                 for uv in scene.seen_rig.project(corners)[:2]]
        vehicles.append({'frame': frame, **{
            key: [[round(float(u), 2), round(float(v), 2)] for u, v in quad]
            for key, quad in zip(('left_image', 'right_image'), quads)}})
    return {'stereo_speed_init': 1, 'vehicles': vehicles}
