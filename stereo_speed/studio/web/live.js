// Copyright 2026 The stereo_speed developers
// SPDX-License-Identifier: Apache-2.0
// The live page: annotated images, current speeds, passes, the rig, and the state of each node.

import {digits, el, renew} from './dom.js';

const MPH = 0.44704;
const LEVELS = [['good', 'good'], ['warning', 'warn'], ['error', 'bad'], ['stale', 'bad']];
const SILENT_S = 4; // time since the last status of a node
const SHOWN_S = 15; // how long a vehicle is shown after its last reading
const ANGLES = ['pan', 'tilt', 'roll'];

export class Live {
  constructor() {
    this.images = el('div', {class: 'images'});
    this.facts = el('div', {class: 'panel facts-row', id: 'live-facts'});
    this.now = el('div', {class: 'cards', id: 'speeds'});
    this.passes = el('div', {class: 'panel grow', id: 'live-passes'});
    this.rig = el('div', {class: 'panel', id: 'live-rig'});
    this.health = el('div', {class: 'panel', id: 'health'});
    this.root = el('div', {class: 'live'}, el('div', {}, this.facts, this.images, this.now),
      el('div', {}, this.passes, this.rig, this.health));
    this.pictures = {};
    this.connected = true;
  }

  set(state) {
    this.state = state;
    if (this.root.isConnected) this.draw();
  }

  // Without a connection everything on the page is out of date.
  setConnected(connected) {
    this.connected = connected;
    if (this.state && this.root.isConnected) this.draw();
  }

  shown() { if (this.state) this.draw(); }

  old(age, after = this.state.stale_after_s) { return !this.connected || age > after; }

  draw() {
    this.drawFacts();
    this.drawImages();
    this.drawSpeeds();
    this.drawPasses();
    this.drawRig();
    this.drawHealth();
  }

  // The status of the measuring node, the newest one where there are several.
  measuring() {
    return [...this.state.health].filter((h) => 'measured_hz' in h.values).sort((a, b) => a.age_s - b.age_s)[0];
  }

  drawFacts() {
    const {state} = this, node = this.measuring(), values = node && !this.old(node.age_s, SILENT_S) ? node.values : {};
    const fact = (name, value, id) => el('div', {}, el('div', {class: 'fine'}, name), el('div', {class: 'num', id}, value));
    const number = (key, count) => (key in values ? digits(Number(values[key]), count) : '–');
    const ms = (key) => (key in values ? digits(1e3 * Number(values[key]), 0) : '–');
    const fresh = !this.connected ? 'connection lost' : state.age_s === null ? 'nothing yet'
      : state.stale ? `nothing for ${digits(state.age_s, 0)} s` : 'live';
    renew(this.facts, el('span', {class: `pill ${fresh === 'live' ? 'good' : 'bad'}`, id: 'fresh'}, fresh),
      fact('pairs a second', number('measured_hz', 1), 'rate'), fact('latency, ms: half, 95 %',
        `${ms('latency_p50_s')}, ${ms('latency_p95_s')}`, 'latency'),
      fact('pairs', values.pairs ?? '–', 'pairs'), fact('skipped', values.skipped ?? '–'), fact('passes', values.passes ?? '–'));
  }

  drawImages() {
    for (const [view, age] of Object.entries(this.state.views)) {
      if (!this.pictures[view]) {
        const image = el('img', {alt: `${view} view`});
        this.pictures[view] = {image, name: el('span', {class: 'name'})};
        this.pictures[view].box = el('div', {class: 'shot', 'data-view': view}, image, this.pictures[view].name);
        renew(this.images, Object.keys(this.pictures).sort().map((key) => this.pictures[key].box));
      }
      const {image, name, box} = this.pictures[view], old = this.old(age);
      if (!old && image.dataset.number !== String(this.state.number)) {
        image.dataset.number = String(this.state.number);
        image.src = `/api/live/overlay/${view}?n=${this.state.number}`;
      }
      box.classList.toggle('stale', old);
      name.textContent = old ? `${view} view, ${digits(age, 0)} s old` : `${view} view`;
    }
    if (!Object.keys(this.pictures).length) {
      renew(this.images, el('p', {class: 'fine'}, 'Images appear here when a node measures.'));
    }
  }

  drawSpeeds() {
    const last = new Map();
    this.state.readings.forEach((r) => last.set(r.track, r));
    const cards = [...last.values()].filter((r) => r.age_s < SHOWN_S).sort((a, b) => a.age_s - b.age_s).slice(0, 8);
    renew(this.now, cards.map((r) => el('div', {class: `panel card ${this.old(r.age_s) ? 'stale' : ''}`, 'data-track': r.track},
      el('span', {class: 'fine'}, r.track.replace('_', ' '), this.old(r.age_s) && ` · ${digits(r.age_s, 0)} s ago`),
      el('span', {class: 'big num'}, `${digits(r.speed_mps / MPH, 1)} mph`),
      el('span', {class: 'fine num'}, `± ${digits(r.std_mps / MPH)} mph · ${digits(r.speed_mps * 3.6, 1)} km/h`))));
  }

  drawPasses() {
    const rows = [...this.state.passes].reverse().map((p) => el('tr', {}, el('td', {class: 'num'}, p.track), el('td', {}, p.lane),
      el('td', {class: 'num'}, p.speed_mps === null ? '–' : `${digits(p.speed_mps / MPH)} ± ${digits(p.speed_std_mps / MPH)}`),
      el('td', {}, el('span', {class: `pill ${p.verdict === 'measured' ? 'good' : 'bad'}`}, p.verdict), ` ${p.reason || ''}`)));
    renew(this.passes, el('h2', {}, 'Passes'), rows.length ? el('table', {}, el('thead', {}, el('tr', {},
      ['#', 'lane', 'mph', 'verdict'].map((t, i) => el('th', {class: i % 2 ? '' : 'num'}, t)))), el('tbody', {}, rows))
      : el('p', {class: 'fine'}, 'Passes appear here as they end.'));
  }

  // Sway and drift of the rig, as reported by the measuring node.
  drawRig() {
    const node = this.measuring(), values = node ? node.values : {};
    const three = (key) => { try { return JSON.parse(values[key]); } catch { return null; } };
    const [sway, rest, drift, std] = ['rig_sway_rms_deg', 'rig_rest_deg', 'rig_drift_deg', 'rig_drift_std_deg'].map(three);
    const line = (name, of) => (of ? el('tr', {}, el('td', {class: 'fine'}, name),
      of.map((v) => el('td', {class: 'num'}, digits(v, 4)))) : null);
    renew(this.rig, el('h2', {}, 'Rig, degrees'), sway ? el('table', {class: this.old(node.age_s, SILENT_S) ? 'stale' : ''},
      el('thead', {}, el('tr', {}, el('th', {}), ANGLES.map((a) => el('th', {class: 'num'}, a)))), el('tbody', {},
        line('sway (r.m.s.)', sway), line('rests at', rest), line('right camera', drift),
        line('its 1-σ', std)))
      : el('p', {class: 'fine'}, node ? 'Not monitored: steadying is off.' : 'Sway and drift appear here.'));
  }

  drawHealth() {
    renew(this.health, el('h2', {}, 'Nodes'), this.state.health.length ? el('table', {}, el('tbody', {},
      this.state.health.map((h) => {
        const [word, tone] = this.old(h.age_s, SILENT_S) ? ['silent', 'bad'] : LEVELS[h.level] || LEVELS[3];
        return el('tr', {title: Object.entries(h.values).map(([k, v]) => `${k}: ${v}`).join('\n')},
          el('td', {class: 'wraps'}, h.name), el('td', {}, el('span', {class: `pill ${tone}`}, word)),
          el('td', {class: 'fine wraps'}, h.message));
      }))) : el('p', {class: 'fine'}, 'No status from any node yet.'));
  }
}
