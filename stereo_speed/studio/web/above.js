// Copyright 2026 The stereo_speed developers
// SPDX-License-Identifier: Apache-2.0
// The road from above: along the road to the right, its left side up, lengths in metres.

import {el, svg} from './dom.js';

const EDGE = 26;
const STEPS = [1, 2, 5, 10, 20, 50, 100];

function scaleOf(low, high, from, to) {
  const factor = (to - from) / Math.max(high - low, 1e-6);
  return (value) => from + (value - low) * factor;
}

function ticks(low, high, most) {
  const step = STEPS.find((s) => (high - low) / s <= most) || 200;
  const out = [];
  for (let x = Math.ceil(low / step) * step; x <= high; x += step) out.push(x);
  return out;
}

export function above(top, draft, colour, [width, height]) {
  const [wide, high] = [Math.max(width, 240), Math.max(height, 120)];
  const title = el('h2', {}, 'From above');
  if (!top) {
    return [title, el('p', {class: 'fine'}, 'The fitted road appears here once a line has two points in each view.')];
  }
  const all = [...Object.values(top.lines), ...Object.values(top.lanes)].flat().concat([top.camera]);
  const along = all.map((p) => p[0]), across = all.map((p) => p[1]);
  const [a0, a1] = [Math.min(...along) - 2, Math.max(...along) + 2];
  const [c0, c1] = [Math.min(...across) - 1.5, Math.max(...across) + 1.5];
  const x = scaleOf(a0, a1, EDGE + 8, wide - 6), y = scaleOf(c0, c1, high - EDGE, 6);
  const path = (points) => points.map((p, i) => `${i ? 'L' : 'M'}${x(p[0]).toFixed(1)} ${y(p[1]).toFixed(1)}`).join('');
  const parts = [
    ticks(a0, a1, 10).map((t) => [svg('path', {d: `M${x(t)} 6V${high - EDGE}`, stroke: '#e6ecef'}),
      svg('text', {x: x(t), y: high - 10, 'text-anchor': 'middle'}, `${t}`)]),
    ticks(c0, c1, 6).map((t) => [svg('path', {d: `M${EDGE + 8} ${y(t)}H${wide - 6}`, stroke: '#e6ecef'}),
      svg('text', {x: EDGE + 2, y: y(t) + 4, 'text-anchor': 'end'}, `${t}`)]),
    draft.lanes.filter((l) => top.lanes[l.number]).map((lane) => {
      const points = top.lanes[lane.number], middle = points[Math.floor(points.length / 2)];
      return [svg('path', {d: path(points), stroke: '#94a3ab', fill: 'none', 'stroke-dasharray': '7 5'}),
        svg('text', {x: x(middle[0]), y: y(middle[1]) - 4, 'text-anchor': 'middle'}, lane.name),
        head(points, x, y)];
    }),
    draft.lines.filter((l) => top.lines[l.number]).map((line) => svg('path', {d: path(top.lines[line.number]), fill: 'none',
      stroke: colour(line.number), 'stroke-width': 2.6})),
    camera(top, x, y)];
  return [el('div', {class: 'row'}, title, el('span', {class: 'fine num end'},
    `metres; the camera stands ${top.camera_height_m.toFixed(1)} m above the road`)),
  svg('svg', {class: 'map', viewBox: `0 0 ${wide} ${high}`, role: 'img', 'aria-label': 'Road from above'}, parts.flat(Infinity))];
}

function head(points, x, y) {
  const [a, b] = [points.at(-2), points.at(-1)].map((p) => [x(p[0]), y(p[1])]);
  const turn = (Math.atan2(b[1] - a[1], b[0] - a[0]) * 180) / Math.PI;
  return svg('path', {d: 'M0 0L-9 -4V4Z', fill: '#94a3ab', transform: `translate(${b[0]} ${b[1]}) rotate(${turn})`});
}

function camera(top, x, y) {
  const [cx, cy] = [x(top.camera[0]), y(top.camera[1])];
  const [[a, b], [c, d]] = top.axis;
  const turn = (Math.atan2(y(d) - y(b), x(c) - x(a)) * 180) / Math.PI;
  return [svg('path', {d: 'M0 0L26 -11V11Z', fill: '#0f766e33', transform: `translate(${cx} ${cy}) rotate(${turn})`}),
    svg('circle', {cx, cy, r: 4.5, fill: '#0f766e'})];
}
