// Copyright 2026 The stereo_speed developers
// SPDX-License-Identifier: Apache-2.0
// Create elements; text is always inserted as text, never as markup.

const SVG = 'http://www.w3.org/2000/svg';

function fill(element, props, children) {
  for (const [key, value] of Object.entries(props || {})) {
    if (value === undefined || value === null || value === false) continue;
    if (key.startsWith('on')) element.addEventListener(key.slice(2), value);
    else if (key === 'style') Object.entries(value).forEach(([k, v]) => element.style.setProperty(k, v));
    else if (key === 'value' || key === 'checked') element[key] = value;
    else element.setAttribute(key, value === true ? '' : String(value));
  }
  for (const child of children.flat(Infinity)) {
    if (child !== null && child !== undefined && child !== false) element.append(child);
  }
  return element;
}

export const el = (tag, props, ...children) => fill(document.createElement(tag), props, children);
export const svg = (tag, props, ...children) => fill(document.createElementNS(SVG, tag), props, children);
export const byId = (id) => document.getElementById(id);

// Replace a part of the page, but keep the focus and unfinished input of the user.
export function renew(parent, ...children) {
  const active = document.activeElement;
  const inside = parent.contains(active) && active !== parent;
  const key = inside ? active.dataset.key : null;
  const typed = key && active.dataset.dirty ? active.value : null;
  const range = typed === null || !('selectionStart' in active) ? null : [active.selectionStart, active.selectionEnd];
  const scroll = parent.scrollTop;
  if (key) active.dataset.renewed = '1'; // browsers fire 'change' when a focused field is removed
  parent.replaceChildren(...children.flat(Infinity).filter((c) => c !== null && c !== false && c !== undefined));
  parent.scrollTop = scroll;
  if (!key) return;
  const again = [...parent.querySelectorAll('[data-key]')].find((e) => e.dataset.key === key);
  if (!again) return;
  if (typed !== null) { again.value = typed; again.dataset.dirty = '1'; }
  again.focus({preventScroll: true});
  try { if (range) again.setSelectionRange(...range); } catch { /* number fields have no selection */ }
}

export function toast(text, bad = false) {
  const box = el('div', {class: bad ? 'bad' : ''}, text);
  byId('toasts').append(box);
  setTimeout(() => box.remove(), bad ? 8000 : 3500);
}

// A field that reports its value when it loses focus or Enter is pressed.
export function field(props, value, tell) {
  const input = el('input', {type: 'text', autocomplete: 'off', spellcheck: 'false', ...props, value});
  const done = () => {
    if (input.dataset.renewed || !input.dataset.dirty) return;
    delete input.dataset.dirty;
    if (input.value !== String(value)) tell(input.value);
  };
  input.addEventListener('input', () => { input.dataset.dirty = '1'; });
  // 'change' alone does not suffice: text typed before a renewal is no change to the browser
  input.addEventListener('change', done);
  input.addEventListener('blur', done);
  input.addEventListener('keydown', (event) => {
    if (event.key === 'Enter') done();
    if (event.key === 'Escape') { input.value = value; delete input.dataset.dirty; input.blur(); }
  });
  return input;
}

export function choice(props, options, value, tell) {
  const select = el('select', {...props, onchange: () => tell(select.value)},
    options.map(([key, text]) => el('option', {value: key, selected: key === String(value ?? '')}, text)));
  select.value = String(value ?? '');
  return select;
}

export const digits = (value, count = 2) => (value === null || value === undefined || !Number.isFinite(value)
  ? '–' : value.toFixed(count));
