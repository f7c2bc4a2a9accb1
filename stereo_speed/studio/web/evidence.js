// Copyright 2026 The stereo_speed developers
// SPDX-License-Identifier: Apache-2.0
// Records of violations: their verification, pictures and figures.

import {digits, el, renew} from './dom.js';

const FACTS = [['considered', null], ['second_mps', 'second estimate'], ['tolerance_mps', 'tolerance'], ['margin_mps', 'margin'],
  ['first_utc', 'from'], ['last_utc', 'to'], ['clock', 'stamps'], ['place', 'place'], ['site', 'site'], ['direction', 'direction'],
  ['instrument', 'instrument'], ['approved', 'approved'], ['run', 'run'], ['vehicle', 'vehicle'], ['unreadable', 'not readable']];

export class Verification {
  constructor(link, changed) {
    this.link = link;
    this.changed = changed;
    this.root = el('div', {id: 'verification', role: 'status', class: 'verification'});
  }

  // Show the records of a run; null for a run without any.
  async open(run) {
    this.run = run;
    this.found = null;
    this.show();
    if (run === null) return;
    try {
      const found = await this.link.get(`/api/runs/${run}/verified`);
      if (this.run !== run) return;
      this.found = found;
    } catch (error) {
      if (this.run === run) this.found = {faults: [error.message], notes: [], records: 0, keys: [], of: {}};
    }
    this.show();
    this.changed();
  }

  show() {
    const {found} = this;
    this.root.hidden = this.run === null;
    if (this.run === null) { renew(this.root); return; }
    if (!found) { renew(this.root, el('div', {class: 'note'}, 'Verifying: every file is read …')); return; }
    const sound = !found.faults.length;
    renew(this.root,
      el('div', {class: `note ${sound ? 'good' : 'error'}`}, el('b', {}, sound
        ? `${found.records} ${found.records === 1 ? 'record' : 'records'}, sound. ` : `NOT SOUND: ${found.faults.length} ${found.faults.length === 1 ? 'fault' : 'faults'}`),
      found.faults.slice(0, 6).map((line) => el('div', {}, line)),
      found.faults.length > 6 && el('div', {}, `and ${found.faults.length - 6} more`)),
      found.keys.map((key) => el('div', {class: 'fine'}, 'signed by ', el('code', {}, key))),
      found.notes.map((line) => el('div', {class: 'fine'}, line)));
  }

  rank(key) { return this.found?.of[key] ? 0 : 1; }

  pill(key) {
    if (!this.found) return el('span', {class: 'pill'}, 'verifying');
    return this.found.of[key] ? el('span', {class: 'pill bad'}, 'not sound') : this.found.faults.length
      ? el('span', {class: 'pill warn'}, 'itself sound') : el('span', {class: 'pill good'}, 'sound');
  }

  faultsOf(key) {
    return (this.found?.of[key] || []).map((line) => el('div', {class: 'note error'}, line));
  }
}

// The marked pictures, then all files for download.
export function pictures(files, at) {
  const shown = files.map((name, index) => [name, index]).filter(([name]) => /_marked\.jpg$|^close_up\.jpg$/.test(name));
  const link = ([name, index]) => el('a', {href: `${at}${index}`, download: name.replaceAll('/', '_')}, name);
  return [el('div', {class: 'pictures'}, shown.map(([name, index]) => el('img', {src: `${at}${index}`, alt: name, title: name,
    loading: 'lazy'}))),
    files.length ? el('details', {}, el('summary', {class: 'fine'}, `${files.length} files of the record`),
      el('ul', {class: 'files fine'}, files.map((name, index) => el('li', {}, link([name, index]))))) : null];
}

// A number without trailing zeros, with at most two decimals.
export const shortly = (value) => String(Number(digits(value)));

export function facts(pass, said) {
  const rows = FACTS.map(([key, name]) => {
    const value = pass[key];
    if (value === null || value === undefined || value === '') return null;
    if (key === 'considered') return ['considered', `${value} ${pass.unit}, limit ${shortly(pass.limit)} ${pass.unit}`];
    if (key.endsWith('_utc')) return [name, `${value.slice(0, 23).replace('T', ' ')} UTC`];
    return [name, key.endsWith('_mps') ? said(value) : String(value)];
  }).filter(Boolean);
  return el('table', {id: 'facts', class: 'facts'}, el('tbody', {}, rows.map(([name, value]) => el('tr', {},
    el('td', {class: 'fine'}, name), el('td', {}, value)))));
}
