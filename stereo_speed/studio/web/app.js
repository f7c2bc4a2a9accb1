// Copyright 2026 The stereo_speed developers
// SPDX-License-Identifier: Apache-2.0
// The page: its tabs and tools, and the distribution of the server's messages.

import {byId, el, renew, toast} from './dom.js';
import {Link} from './link.js';
import {Live} from './live.js';
import {Review} from './review.js';
import {Setup} from './setup.js';

const link = new Link();
const pages = {setup: new Setup(link), review: new Review(link), live: new Live(link)};
const NAMES = {setup: 'Set up', review: 'Review', live: 'Live'};
let there = [], shown = null, state = null;

function tabs() {
  renew(byId('tabs'), there.map((key) => el('button', {role: 'tab', 'aria-selected': key === shown ? 'true' : 'false',
    id: `tab-${key}`, 'data-key': key, onclick: () => go(key)}, NAMES[key])));
}

function go(key) {
  if (!there.includes(key)) return;
  shown = key;
  if (location.hash !== `#${key}`) history.replaceState(null, '', `#${key}`);
  byId('page').replaceChildren(pages[key].root);
  tabs();
  tools();
  pages[key].shown?.();
}

function tools() {
  const setup = pages.setup;
  if (shown !== 'setup' || !setup.workspace) { renew(byId('tools')); return; }
  const {undo, redo, unsaved, site_file: file, draft} = setup.workspace;
  const busy = Boolean(setup.busy);
  renew(byId('tools'),
    el('button', {id: 'undo', 'data-key': 'undo', title: 'Ctrl+Z', disabled: !undo, onclick: () => link.step('undo')}, 'Undo'),
    el('button', {id: 'redo', 'data-key': 'redo', title: 'Ctrl+Y', disabled: !redo, onclick: () => link.step('redo')}, 'Redo'),
    el('button', {id: 'snap', 'data-key': 'snap', title: 'Snap points to a marking nearby (S)',
      'aria-pressed': setup.snap ? 'true' : 'false', onclick: () => setup.toggleSnap()}, 'Snap'),
    el('button', {id: 'refine', 'data-key': 'refine', disabled: busy || !draft.lanes.length,
      title: 'Find all lines in the images, and check the calibration of the rig',
      onclick: () => link.ask('/api/refine', {}, (r) => (r.kept_clicks ? `lines stay as clicked: ${r.kept_clicks}`
        : 'lines found in the images'))}, 'Refine'),
    el('button', {id: 'measure', 'data-key': 'measure', disabled: busy || !draft.lanes.length,
      title: 'Measure the vehicles of this bag with this site', onclick: measure}, 'Measure'),
    el('button', {id: 'keys', class: 'quiet', 'data-key': 'keys', title: 'Keys (?)', onclick: help}, '?'),
    el('button', {id: 'save', class: 'main end', 'data-key': 'save', title: 'Ctrl+S', disabled: !unsaved,
      onclick: () => setup.save('site')}, unsaved ? `Save ${file}` : `Saved ${file}`));
}

async function measure() {
  const result = await link.ask('/api/measure', {});
  if (result) { pages.review.open(result.run); go('review'); }
}

function help() {
  const rows = [['click or drag', 'set a point, or move one'], ['wheel, + − 0', 'zoom; 0 shows all'],
    ['right or Ctrl drag, Space', 'move the image'], ['arrows', 'cursor by 1 px; Shift 10, Alt 0.1'],
    ['Enter', 'set a point at the cursor; Shift+Enter moves the chosen one there'],
    [', .', 'choose the point before, the next'], ['Delete', 'delete the chosen point'],
    ['N', 'new line'], ['L', 'lanes between neighbouring lines'], ['V', 'the other view'], ['S', 'snap on or off'],
    ['Ctrl+Z, Ctrl+Y', 'undo, redo'], ['Ctrl+S', 'save the site'], ['1 2 3', 'pages']];
  const dialog = byId('help');
  dialog.replaceChildren(el('h1', {}, 'Keys'), el('dl', {}, rows.map(([k, t]) => [el('dt', {}, el('kbd', {}, k)), el('dd', {}, t)])));
  dialog.showModal();
}

function showLink() {
  const box = byId('link'), waiting = link.waiting.length;
  box.classList.toggle('lost', !link.connected);
  box.textContent = link.connected ? (waiting ? `${waiting} to send` : (pages.setup.busy || ''))
    : `connection lost, trying again${waiting ? `; ${waiting} steps kept` : ''}`;
}

link.on('state', (now) => {
  state = now;
  there = [now.workspace && 'setup', (now.runs.length || now.workspace) && 'review', now.has_live && 'live'].filter(Boolean);
  pages.setup.busy = now.busy;
  pages.setup.setScene(now.scene);
  pages.setup.figures = now.figures;
  if (now.workspace) pages.setup.setWorkspace(now.workspace);
  pages.review.setRuns(now.runs);
  const wanted = location.hash.slice(1);
  if (!there.length) {
    byId('page').replaceChildren(el('div', {class: 'empty'}, el('h1', {}, 'Nothing is open'),
      el('p', {}, 'Start it with a bag to draw a site on, or with ', el('code', {}, '--run DIR'), ' to review.')));
  } else if (!shown) {
    go(there.includes(wanted) ? wanted : there[0]);
  } else { tabs(); tools(); }
  showLink();
});
link.on('draft', (message) => { pages.setup.setWorkspace(message.workspace); tools(); });
link.on('figures', (message) => pages.setup.setFigures(message.figures));
link.on('busy', (message) => { pages.setup.setBusy(message.busy); tools(); showLink(); });
link.on('runs', (message) => {
  pages.review.setRuns(message.runs);
  if (!there.includes('review')) { there.splice(1, 0, 'review'); tabs(); }
});
link.on('live', (message) => pages.live.set(message));
link.on('link', () => { showLink(); pages.live.setConnected(link.connected); });
link.on('tools', tools);
link.on('refused', () => { pages.setup.ghost = null; pages.setup.paint(); });

document.addEventListener('keydown', (event) => {
  if (event.target.closest('input, select, textarea, dialog') && !(event.ctrlKey && event.key === 's')) return;
  if (event.key === '?') { help(); return; }
  const page = {1: 'setup', 2: 'review', 3: 'live'}[event.key];
  if (page && !event.ctrlKey && !event.altKey) { go(page); return; }
  if (shown && pages[shown].globalKey?.(event)) event.preventDefault();
});
window.addEventListener('hashchange', () => go(location.hash.slice(1)));
window.addEventListener('error', (event) => toast(event.message, true));
link.start();
