// Copyright 2026 The stereo_speed developers
// SPDX-License-Identifier: Apache-2.0
// Details of one pass: frames or pictures, both estimates, the budget of the 1-sigma, the profile.

import {profile} from './charts.js';
import {choice, digits, el, renew, svg} from './dom.js';
import {facts, pictures} from './evidence.js';

const PARTS = [['std_matching_mps', 'matching', '#0f766e'], ['std_path_mps', 'path', '#d97706'],
  ['std_stamps_mps', 'stamps', '#7c3aed'], ['std_calibration_mps', 'calibration', '#2563eb']];
const FRONT_M = [1.8, 1.3]; // width and height of the box drawn around a front
const LEAST_ZOOM_PX = 160; // least image width that a close view shows

export class Closely {
  constructor(link, review, root) {
    this.link = link;
    this.review = review;
    this.root = root;
    this.near = false;
  }

  async open(row) {
    const run = this.review.at;
    this.row = row;
    let found;
    try {
      found = await this.link.get(`/api/runs/${run}/pass/${row.key}`);
    } catch { found = {rows: [], frames: [], more: {}}; }
    if (this.row !== row || this.review.at !== run) return;
    this.found = found;
    this.frame = Math.floor(found.rows.length / 2);
    this.view = 'left';
    this.show();
  }

  said(mps, count = 2) { return digits(mps === null || mps === undefined ? null : mps / this.review.metres, count); }

  show() {
    if (!this.row || !this.found) return;
    const {row, found, review} = this, pass = {...row, ...found.more};
    const {rows} = found, {unit, metres} = review;
    const of = (v) => (v === null || v === undefined ? null : v / metres);
    const chart = rows.length > 1 && [el('div', {class: 'row'}, el('h2', {}, `Speed over the pass, ${unit}`),
      el('div', {class: 'legend end'}, legend('#d97706', 'live, 1-σ'), legend('#16232b', 'smoothed'), legend('#0f766e', 'final'))),
    profile(rows, of(row.speed_mps), of(row.speed_std_mps), unit, metres)];
    const pictured = review.isEvidence || found.frames.length > 0;
    const worth = [this.estimates(pass), this.budget(pass)];
    renew(this.root,
      el('div', {class: 'row wrap', style: {gap: '12px'}}, el('span', {class: 'big num', id: 'pass-speed'},
        row.speed_mps === null ? 'no speed' : `${this.said(row.speed_mps)} ± ${this.said(row.speed_std_mps)} ${unit}`),
      review.isEvidence ? review.verification.pill(row.key)
        : el('span', {class: `pill ${row.verdict === 'measured' ? 'good' : 'bad'}`}, row.verdict), row.reason,
      el('span', {class: 'fine end'}, review.isEvidence ? row.id : `vehicle ${row.track} · ${row.lane}`)),
      review.isEvidence && review.verification.faultsOf(row.key),
      !pictured && chart,
      el('div', {class: 'close'},
        el('div', {}, review.isEvidence ? pictures(found.files || [], `/api/runs/${review.at}/pass/${row.key}/file/`)
          : pictured ? this.frameBox() : worth),
        el('div', {}, pictured && worth,
          review.isEvidence ? facts(pass, (mps) => `${this.said(mps)} ${unit}`) : this.further(pass))),
      pictured ? chart : this.framesAre(),
      review.run.plots.map((name) => el('img', {src: `/api/runs/${review.at}/plot/${name}`, alt: name,
        style: {width: '100%'}, loading: 'lazy'})));
  }

  // Both estimates, and their difference in sigmas.
  estimates(pass) {
    if (typeof pass.second_mps !== 'number' || typeof pass.speed_mps !== 'number') return null;
    const std = Math.hypot(pass.speed_std_mps, pass.second_std_mps || 0);
    const line = (name, mps, sigma) => el('tr', {}, el('td', {class: 'fine'}, name),
      el('td', {class: 'num'}, `${this.said(mps)} ± ${this.said(sigma)}`));
    return [el('h2', {}, `Two estimates, ${this.review.unit}`), el('table', {id: 'estimates'}, el('tbody', {},
      line('tracker', pass.speed_mps, pass.speed_std_mps), line('second', pass.second_mps, pass.second_std_mps),
      el('tr', {}, el('td', {class: 'fine'}, 'apart'), el('td', {class: 'num'},
        `${this.said(pass.second_mps - pass.speed_mps)} = ${digits((pass.second_mps - pass.speed_mps) / std, 1)} σ`))))];
  }

  budget(pass) {
    const {review} = this;
    const parts = PARTS.map(([key, name, colour]) => [pass[key], name, colour]).filter(([v]) => typeof v === 'number');
    const total = parts.reduce((sum, [v]) => sum + v * v, 0);
    if (!total) return null;
    return [el('h2', {}, 'Budget of the 1-σ'),
      el('div', {class: 'budget', role: 'img', 'aria-label': 'Shares of the variance'}, parts.map(([v, , colour]) =>
        el('div', {style: {background: colour, width: `${(100 * v * v) / total}%`}}))),
      el('div', {class: 'legend num'}, parts.map(([v, name, colour]) => legend(colour,
        `${name} ${this.said(v, 3)} ${review.unit}`)))];
  }

  further(pass) {
    const {unit} = this.review;
    const metre = (v, std) => typeof v === 'number' && `${digits(v)} ± ${digits(std)} m`;
    const rows = [['first, last', typeof pass.first_mps === 'number' && `${this.said(pass.first_mps)}, ${this.said(pass.last_mps)} ${unit}`],
      ['greatest', typeof pass.max_mps === 'number' && `${this.said(pass.max_mps)} ${unit}`],
      ['class', pass.class && pass.class.replaceAll('_', ' ') + (typeof pass.class_probability === 'number'
        ? `, ${digits(100 * pass.class_probability, 0)} %` : '')],
      ['width', metre(pass.width_m, pass.width_std_m)], ['height', metre(pass.height_m, pass.height_std_m)],
      ['direction', pass.direction], ['ended', pass.end && pass.end.replaceAll('_', ' ')],
      ['run', pass.run], ['bag', pass.bag]];
    return el('table', {}, el('tbody', {}, rows.filter(([, value]) => value).map(([name, value]) => el('tr', {},
      el('td', {class: 'fine'}, name), el('td', {class: 'num'}, value)))));
  }

  framesAre() {
    return this.review.run.kind === 'folder'
      ? el('p', {class: 'fine'}, 'Frames are shown if the measured bag is open.') : null;
  }

  frameBox() {
    const {frames, rows} = this.found;
    const frame = frames[this.frame];
    const slider = el('input', {type: 'range', min: '0', max: String(rows.length - 1), value: String(this.frame), class: 'grow',
      'aria-label': 'Pair', 'data-key': 'slider', oninput: () => { this.frame = Number(slider.value); this.show(); }});
    const image = el('img', {src: `/api/frame/${frame.index}/${this.view}`, alt: `pair ${frame.index}, ${this.view} view`,
      id: 'frame'});
    const over = svg('svg', {'aria-hidden': 'true'});
    const box = el('div', {class: 'frame'}, image, over);
    image.addEventListener('load', () => this.drawOver(over, image, frame));
    return [box,
      el('div', {class: 'row'}, slider, el('span', {class: 'fine num'}, `pair ${frame.index}`)),
      el('div', {class: 'row'}, choice({'data-key': 'view', 'aria-label': 'View'}, [['left', 'left view'], ['right', 'right view']],
        this.view, (view) => { this.view = view; this.show(); }),
      el('button', {'data-key': 'near', id: 'near', 'aria-pressed': this.near ? 'true' : 'false',
        onclick: () => { this.near = !this.near; this.show(); }}, 'Close-up'))];
  }

  // Boxes and speeds over an image; a close view is the same image, cropped by the viewBox.
  drawOver(over, image, frame) {
    const {naturalWidth: width, naturalHeight: height} = image;
    const own = frame.vehicles.find((v) => v.track === this.row.track)?.views[this.view];
    let part = [-0.5, -0.5, width, height];
    if (this.near && own) {
      const w = Math.min(Math.max(own.px_per_m * FRONT_M[0] * 4, LEAST_ZOOM_PX), width), h = (w * height) / width;
      part = [Math.min(Math.max(own.u - w / 2, -0.5), width - w), Math.min(Math.max(own.v - h / 2, -0.5), height - h), w, h];
    }
    const unit = part[2] / width; // text and lines keep their size on the page
    over.setAttribute('viewBox', part.join(' '));
    image.style.opacity = '0'; // it only sets the size of the box; the image is drawn by the SVG
    over.replaceChildren(svg('image', {href: image.src, x: -0.5, y: -0.5, width, height}),
      ...frame.vehicles.flatMap((v) => this.vehicle(v, unit)));
  }

  vehicle(v, unit) {
    const place = v.views[this.view], own = v.track === this.row.track;
    if (!place) return [];
    const [w, h] = FRONT_M.map((m) => m * place.px_per_m);
    const text = v.state === 'confirmed' ? `${this.said(v.speed_mps, 1)} ${this.review.unit}` : v.state;
    return [svg('rect', {x: place.u - w / 2, y: place.v - h / 2, width: w, height: h, fill: 'none', rx: 4 * unit,
      stroke: own ? '#2dd4bf' : '#94a3ab', 'stroke-width': (own ? 4 : 2) * unit}),
    svg('text', {x: place.u, y: place.v - h / 2 - 10 * unit, 'text-anchor': 'middle', 'font-size': 34 * unit,
      'stroke-width': 5 * unit}, text)];
  }
}

export const legend = (colour, text) => el('span', {}, el('i', {style: {background: colour}}), text);
