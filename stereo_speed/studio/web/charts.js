// Copyright 2026 The stereo_speed developers
// SPDX-License-Identifier: Apache-2.0
// Small charts as SVG, and the figures behind them.

import {svg} from './dom.js';

const W = 520, H = 138, LEFT = 40, RIGHT = 16, TOP = 8, BOTTOM = 24;

// Percentile of values with linear interpolation, the default of numpy.
export function percentile(values, share) {
  if (!values.length) return null;
  const sorted = [...values].sort((a, b) => a - b);
  const at = (sorted.length - 1) * share, low = Math.floor(at);
  return sorted[low] + (sorted[Math.min(low + 1, sorted.length - 1)] - sorted[low]) * (at - low);
}

function nice(span, most) {
  const raw = span / most, power = 10 ** Math.floor(Math.log10(raw || 1));
  return [1, 2, 5, 10].map((k) => k * power).find((step) => step >= raw) || 1;
}

function axes(x0, x1, y0, y1, whole = false) {
  const x = (v) => LEFT + ((v - x0) / (x1 - x0 || 1)) * (W - LEFT - RIGHT);
  const y = (v) => H - BOTTOM - ((v - y0) / (y1 - y0 || 1)) * (H - TOP - BOTTOM);
  const marks = [];
  const dx = nice(x1 - x0, 8), dy = Math.max(nice(y1 - y0, 4), whole ? 1 : 0);
  const text = (v, step) => v.toFixed(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)));
  for (let v = Math.ceil(x0 / dx - 1e-9) * dx; v <= x1 + 1e-9; v += dx) {
    marks.push(svg('text', {x: x(v), y: H - 8, 'text-anchor': 'middle'}, text(v, dx)));
  }
  for (let v = Math.ceil(y0 / dy - 1e-9) * dy; v <= y1 + 1e-9; v += dy) {
    marks.push(svg('path', {d: `M${LEFT} ${y(v)}H${W - RIGHT}`, stroke: '#e6ecef'}),
      svg('text', {x: LEFT - 5, y: y(v) + 4, 'text-anchor': 'end'}, text(v, dy)));
  }
  return {x, y, marks};
}

const chart = (label, parts) => svg('svg', {class: 'chart', viewBox: `0 0 ${W} ${H}`, role: 'img', 'aria-label': label}, parts);

export function histogram(values, unit, marked) {
  if (!values.length) return null;
  const low = Math.min(...values), high = Math.max(...values);
  const step = Math.max(nice(high - low, 20), 0.5);
  const first = Math.floor(low / step) * step, count = Math.floor((high - first) / step) + 1;
  const bins = new Array(count).fill(0);
  values.forEach((v) => { bins[Math.min(Math.floor((v - first) / step), count - 1)] += 1; });
  const {x, y, marks} = axes(first, first + count * step, 0, Math.max(...bins, 4), true);
  const bars = bins.map((n, i) => svg('rect', {x: x(first + i * step) + 1, y: y(n), height: Math.max(y(0) - y(n), 0),
    width: Math.max(x(step) - x(0) - 2, 1), fill: '#5fa8a1'}, svg('title', {}, `${n}`)));
  const line = marked === null ? [] : [svg('path', {d: `M${x(marked)} ${TOP}V${H - BOTTOM}`, stroke: '#b42318',
    'stroke-dasharray': '4 3'}), svg('text', {x: x(marked) + 4, y: TOP + 10}, `85 %: ${marked.toFixed(1)} ${unit}`)];
  return chart(`Histogram of speeds in ${unit}`, [marks, bars, line].flat(Infinity));
}

// Speeds over time: live readings with their 1-sigma, the smoothed profile, the final speed.
export function profile(rows, speed, std, unit, metres) {
  const start = rows[0].stamp_ns;
  const points = rows.map((r) => ({t: (r.stamp_ns - start) * 1e-9, live: r.speed_mps / metres,
    std: (r.speed_std_mps || 0) / metres, smooth: r.smoothed_mps === null ? null : r.smoothed_mps / metres,
    state: r.state}));
  const told = points.filter((p) => p.state === 'confirmed');
  const used = told.length ? told : points;
  const values = used.flatMap((p) => [p.live - p.std, p.live + p.std]).concat(
    points.filter((p) => p.smooth !== null).map((p) => p.smooth), speed === null ? [] : [speed - std, speed + std]);
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const room = Math.max((high - low) * 0.12, 0.2);
  const {x, y, marks} = axes(0, Math.max(points.at(-1).t, 0.1), low - room, high + room);
  const smooth = points.filter((p) => p.smooth !== null);
  return chart(`Speed over time in ${unit}`, [marks,
    speed === null ? [] : [svg('rect', {x: LEFT, width: W - LEFT - RIGHT, y: y(speed + std),
      height: Math.max(y(speed - std) - y(speed + std), 1), fill: '#0f766e22'}),
    svg('path', {d: `M${LEFT} ${y(speed)}H${W - RIGHT}`, stroke: '#0f766e', 'stroke-dasharray': '5 3'})],
    used.map((p) => [svg('path', {d: `M${x(p.t)} ${y(p.live - p.std)}V${y(p.live + p.std)}`, stroke: '#d97706'}),
      svg('circle', {cx: x(p.t), cy: y(p.live), r: 2.8, fill: '#d97706'})]),
    smooth.length > 1 ? svg('path', {d: smooth.map((p, i) => `${i ? 'L' : 'M'}${x(p.t)} ${y(p.smooth)}`).join(''),
      stroke: '#16232b', fill: 'none', 'stroke-width': 1.6}) : []].flat(Infinity));
}
