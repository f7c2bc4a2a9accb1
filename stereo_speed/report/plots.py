# Copyright 2026 The stereo_speed developers
# SPDX-License-Identifier: Apache-2.0
"""
Plots of a run: speed over time with its 1-sigma band, and the vehicles' positions on the road.

The same run gives the same bytes: fixed size and resolution, no pyplot state, no metadata.
"""
from __future__ import annotations

import io
from pathlib import Path
from typing import Mapping, Optional, Sequence, Union

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np

from ..core.passes import PassResult, Verdict
from ..core.records import Array, TrackState, TrackUpdate
from ..core.units import NS_S, SpeedUnit
from ..road.lanes import LanePath

# Vehicle name to rows of (stamp in ns, speed in m/s).
Truth = Mapping[str, Sequence[tuple[int, float]]]

# Distinguishable with colour blindness (Okabe and Ito); each track has its overlay's colour.
COLOURS = ('#e69f00', '#56b4e9', '#009e73', '#f0e442', '#cc79a7', '#d55e00')
_DPI = 110
_LEGEND = 40  # entries; more would leave no room for the axes
_GREY = '#5b6470'


def write_plots(out_dir: Union[str, Path], updates: Sequence[TrackUpdate],
                passes: Sequence[PassResult], lanes: Mapping[str, LanePath],
                truth: Optional[Truth] = None, unit: SpeedUnit = SpeedUnit()) -> list[Path]:
    """
    Write ``speed.png`` and ``road.png``.

    :param out_dir: an existing folder.
    :param updates: the live updates.
    :param passes: the passes, for their smoothed and final speeds.
    :param lanes: the lanes, for paths and speed limits.
    :param truth: true speeds; None where they are unknown.
    :param unit: unit of the speeds shown.
    :return: the files written.
    """
    figures = {'speed.png': speed_figure(updates, passes, lanes, truth, unit),
               'road.png': road_figure(updates, lanes)}
    for name, figure in figures.items():
        (Path(out_dir) / name).write_bytes(png_of(figure))
    return [Path(out_dir) / name for name in figures]


def png_of(figure: Figure, dpi: int = _DPI) -> bytes:
    """Return a figure as a PNG file; the same figure gives the same bytes."""
    FigureCanvasAgg(figure)
    out = io.BytesIO()
    figure.savefig(out, format='png', dpi=dpi, metadata={'Software': None})
    return out.getvalue()


def colour_of(track: int) -> str:
    """Return the colour of a track."""
    return COLOURS[track % len(COLOURS)]


def speed_figure(updates: Sequence[TrackUpdate], passes: Sequence[PassResult],
                 lanes: Mapping[str, LanePath], truth: Optional[Truth] = None,
                 unit: SpeedUnit = SpeedUnit()) -> Figure:
    """Draw live and smoothed speeds over time, the limits, and the truth where given."""
    figure, axes = new_figure(10.0, 5.4)
    stamps = [u.stamp_ns for u in updates]
    stamps += [stamp for rows in (truth or {}).values() for stamp, _ in rows]
    origin_ns = min(stamps, default=0)
    for track, rows in sorted(_by_track(updates).items()):
        _draw_live(axes, track, rows, origin_ns, unit)
    for result in sorted(passes, key=lambda p: p.track):
        _draw_smoothed(axes, result, origin_ns, unit)
        _draw_second(axes, result, origin_ns, unit)
    for number, (name, points) in enumerate(sorted((truth or {}).items())):
        t_s, speed = _series(points, origin_ns)
        axes.plot(t_s, speed / unit.mps, color='black', lw=1.2, ls=(0, (1, 1.5)), zorder=5,
                  label='truth' if len(truth or {}) == 1 else f'truth of {name}')
    _fit_speeds(axes, updates, passes, truth, unit)
    _draw_limits(axes, lanes, {u.lane for u in updates}, unit)
    axes.set(title='Ground speed', xlabel='time since the first pair, s',
             ylabel=f'speed, {unit.name}')
    other = SpeedUnit('mph' if unit.name == 'km/h' else 'km/h')
    ratio = unit.mps / other.mps
    right = axes.secondary_yaxis('right', functions=(
        lambda speed: np.asarray(speed, float) * ratio,
        lambda speed: np.asarray(speed, float) / ratio))
    right.set_ylabel(f'speed, {other.name}')
    show_legend(figure, axes, columns=3)
    return figure


def road_figure(updates: Sequence[TrackUpdate], lanes: Mapping[str, LanePath]) -> Figure:
    """Draw the road from above, forward to the right: lane paths and vehicle positions."""
    figure, axes = new_figure(11.0, 4.2)
    for name, lane in sorted(lanes.items()):
        _draw_lane(axes, name, lane)
    for track, rows in sorted(_by_track(updates).items()):
        places = np.array([u.position_m for u in rows])
        sure = np.array([u.state is TrackState.CONFIRMED for u in rows])
        colour = colour_of(track)
        axes.plot(places[:, 2], places[:, 0], color=colour, lw=1.0, alpha=0.6, zorder=3)
        axes.scatter(places[sure, 2], places[sure, 0], s=26, color=colour, edgecolor='white',
                     linewidth=0.6, zorder=4, label=f'vehicle {track}')
        axes.scatter(places[~sure, 2], places[~sure, 0], s=26, facecolor='white',
                     edgecolor=colour, zorder=4,
                     label=None if sure.all() else f'vehicle {track}, not confirmed')
    axes.plot(0, 0, marker='>', ms=11, color=_GREY, ls='none', label='left camera')
    axes.set(title='Positions on the road, from above', xlabel='forward of the camera (z), m',
             ylabel='right of the camera (x), m')
    axes.set_aspect('equal', adjustable='datalim')
    axes.margins(0.04, 0.25)
    axes.invert_yaxis()  # seen from above with z to the right, x points down
    show_legend(figure, axes)
    return figure


def new_figure(width_in: float, height_in: float) -> tuple[Figure, Axes]:
    """Make a figure with one set of axes, in the style of all plots."""
    figure = Figure(figsize=(width_in, height_in), layout='constrained')
    axes = figure.add_subplot()
    axes.grid(color='#e3e6ea', lw=0.8)
    axes.set_axisbelow(True)
    axes.spines[['top', 'right']].set_visible(False)
    return figure, axes


def show_legend(figure: Figure, axes: Axes, columns: int = 4) -> None:
    """Put the legend below the axes."""
    handles, labels = axes.get_legend_handles_labels()
    if labels:
        if len(labels) > _LEGEND:
            handles, labels = handles[:_LEGEND], labels[:_LEGEND]
            labels[-1] += ', and others'
        # Below the axes, where it hides nothing; the layout leaves room for legends of axes.
        axes.legend(handles, labels, loc='upper center', bbox_to_anchor=(0.5, -0.14),
                    ncols=columns, frameon=False, fontsize=9)


def _by_track(updates: Sequence[TrackUpdate]) -> dict[int, list[TrackUpdate]]:
    tracks: dict[int, list[TrackUpdate]] = {}
    for update in sorted(updates, key=lambda u: u.stamp_ns):
        tracks.setdefault(update.track, []).append(update)
    return tracks


def _series(rows: Sequence[tuple[int, float]], origin_ns: int) -> tuple[Array, Array]:
    """Split (stamp, value) rows into times (n,) in s and values (n,), by time."""
    rows = sorted(rows)
    return (np.array([stamp - origin_ns for stamp, _ in rows]) * NS_S,
            np.array([value for _, value in rows], dtype=np.float64))


def _draw_live(axes: Axes, track: int, rows: Sequence[TrackUpdate], origin_ns: int,
               unit: SpeedUnit) -> None:
    """Draw a track's live readings as points with bars, hollow until confirmed."""
    t_s, speed = _series([(u.stamp_ns, u.speed_mps / unit.mps) for u in rows], origin_ns)
    std = np.array([u.speed_std_mps for u in rows]) / unit.mps
    sure = np.array([u.state is TrackState.CONFIRMED for u in rows])
    colour = colour_of(track)
    axes.errorbar(t_s, speed, std, fmt='none', ecolor=colour, elinewidth=1.1, alpha=0.55)
    axes.plot(t_s[sure], speed[sure], 'o', ms=5.5, color=colour, mec='white', mew=0.6,
              label=f'vehicle {track}, live ± 1σ')
    axes.plot(t_s[~sure], speed[~sure], 'o', ms=5.5, mfc='white', color=colour,
              label=None if sure.all() else f'vehicle {track}, not confirmed')


def _draw_smoothed(axes: Axes, result: PassResult, origin_ns: int, unit: SpeedUnit) -> None:
    """Draw a pass's smoothed speed with its band; its label has the final speed."""
    t_s, speed = _series(list(result.smoothed.items()), origin_ns)
    std = _series(list(result.smoothed_std.items()), origin_ns)[1]
    label = f'vehicle {result.track}, smoothed'
    if result.verdict is Verdict.MEASURED and result.speed_mps is not None:
        label += f': {result.speed_mps / unit.mps:.2f} ± ' \
                 f'{(result.speed_std_mps or 0.0) / unit.mps:.2f} {unit.name}'
    else:
        label += f': rejected ({result.reason})'
    colour = colour_of(result.track)
    axes.plot(t_s, speed / unit.mps, color=colour, lw=2.0, label=label)
    if len(std) == len(speed):
        axes.fill_between(t_s, (speed - std) / unit.mps, (speed + std) / unit.mps, color=colour,
                          alpha=0.22, lw=0)


def _draw_second(axes: Axes, result: PassResult, origin_ns: int, unit: SpeedUnit) -> None:
    """Draw the second estimate as a line over the pass with an error bar in the middle."""
    second = result.second
    if second is None or second.speed_mps is None:
        return
    begin, end = ((ns - origin_ns) * NS_S for ns in (result.first_ns, result.last_ns))
    speed, std = second.speed_mps / unit.mps, (second.speed_std_mps or 0.0) / unit.mps
    colour = colour_of(result.track)
    axes.plot([begin, end], [speed, speed], color=colour, lw=1.3, ls=(0, (4, 2)),
              label=f'vehicle {result.track}, second estimate: {speed:.2f} ± {std:.2f} '
                    f'{unit.name}')
    axes.errorbar([(begin + end) / 2], [speed], [std], fmt='none', ecolor=colour, elinewidth=1.3,
                  capsize=4)


def _fit_speeds(axes: Axes, updates: Sequence[TrackUpdate], passes: Sequence[PassResult],
                truth: Optional[Truth], unit: SpeedUnit) -> None:
    """Fit the axis to the confirmed speeds; wide first error bars must not flatten the rest."""
    sure = [u for u in updates if u.state is TrackState.CONFIRMED] or list(updates)
    values = [v for u in sure for v in (u.speed_mps - u.speed_std_mps,
                                        u.speed_mps + u.speed_std_mps)]
    values += [v for p in passes for v in p.smoothed.values()]
    values += [v for rows in (truth or {}).values() for _, v in rows]
    finite = [v / unit.mps for v in values if np.isfinite(v)]
    if finite:
        pad = max(0.08 * (max(finite) - min(finite)), 1.0)
        axes.set_ylim(max(min(finite) - pad, 0.0), max(finite) + pad)


def _draw_limits(axes: Axes, lanes: Mapping[str, LanePath], used: set[str],
                 unit: SpeedUnit) -> None:
    """Draw the speed limits of the used lanes; the axis is extended to a limit nearby."""
    for name in sorted(used & set(lanes)):
        limit = lanes[name].speed_limit_mps
        if limit is None:
            continue
        shown = limit / unit.mps
        low, high = axes.get_ylim()
        if abs(shown - np.clip(shown, low, high)) < 15.0:
            axes.set_ylim(min(low, shown - 1.0), max(high, shown + 1.0))
        axes.axhline(shown, color=_GREY, lw=1.2, ls=(0, (6, 4)),
                     label=f'limit of {name}, {shown:.0f} {unit.name}')


def _draw_lane(axes: Axes, name: str, lane: LanePath) -> None:
    """Draw a lane's path with its name and an arrow in the direction of travel."""
    points = lane.path.position(np.linspace(0.0, lane.path.length_m, 200))
    axes.plot(points[:, 2], points[:, 0], color='#b9c0c9', lw=5, solid_capstyle='round',
              zorder=1)
    middle = len(points) // 2
    here, ahead = ((float(z), float(x)) for z, x in points[[middle, middle + 4]][:, [2, 0]])
    axes.annotate('', xy=ahead, xytext=here,
                  arrowprops={'arrowstyle': '-|>', 'color': _GREY, 'lw': 1.4}, zorder=2)
    axes.annotate(f'{name} \N{RIGHTWARDS ARROW}' if points[-1, 2] > points[0, 2]
                  else f'\N{LEFTWARDS ARROW} {name}',
                  xy=here, xytext=(0, 14), textcoords='offset points',
                  color=_GREY, fontsize=9, ha='center')
