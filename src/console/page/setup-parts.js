// Parts that several steps are made of.

import { get } from './api.js';
import { changes } from './changes.js';
import { h, mark, say } from './dom.js';
import { attempt } from './toast.js';

/** The proof of a step, as a box. @returns {{element: HTMLElement, show: (proof: import('./setup-view.js').Proof) => void}} */
export function proofBox() {
  const [sign, what, todo] = [h('span', { class: 'sign' }), h('p', null), h('p', null)];
  const element = h('div', { class: 'proof', role: 'status' }, sign, h('div', null, what, todo));
  return {
    element,
    show(proof) {
      mark(element, 'is-good', proof.level === 'good');
      mark(element, 'is-bad', proof.level === 'bad');
      say(sign, proof.level === 'good' ? '✓' : proof.level === 'bad' ? '!' : '○');
      say(what, proof.what);
      say(todo, proof.todo ?? '');
      todo.hidden = !proof.todo;
    },
  };
}

/** A value of the configuration by its key. @param {string} key */
export function valueOf(key) {
  /** @type {any} */
  let place = changes.values;
  for (const part of key.split('.')) place = place?.[part];
  return place;
}

/**
 * A form for keys of the configuration; each change becomes part of the proposal.
 * @param {{key: string, title: string, unit?: string, min?: number, max?: number, step?: number, choices?: string[], help?: string}[]} fields
 */
export function keysForm(fields) {
  const inputs = fields.map(({ key, min, max, step, choices, help }) => {
    const input = choices
      ? h('select', { id: key, title: help ?? key }, choices.map((choice) => h('option', { value: choice }, choice)))
      : h('input', { id: key, type: typeof valueOf(key) === 'boolean' ? 'checkbox' : 'number', min, max, step: step ?? 'any', title: help ?? key });
    input.addEventListener('change', () => {
      const value = choices ? input.value : input.type === 'checkbox' ? /** @type {HTMLInputElement} */ (input).checked : Number(input.value);
      if (typeof value === 'number' && !(input.value !== '' && Number.isFinite(value))) return;
      changes.propose({ [key]: value });
    });
    return input;
  });
  const element = h('div', { class: 'form' }, fields.flatMap(({ key, title, unit }, index) => [
    h('label', { for: key }, title), h('div', { class: 'unit' }, inputs[index], unit === undefined ? null : h('span', null, unit)),
  ]));
  return {
    element,
    update() {
      fields.forEach(({ key }, index) => {
        const [input, value] = [inputs[index], valueOf(key)];
        if (document.activeElement === input || value === undefined || value === null) return;
        if (typeof value === 'boolean' && input instanceof HTMLInputElement) {
          input.type = 'checkbox';
          input.checked = value;
        } else if (input.value !== String(value)) input.value = String(value);
      });
    },
  };
}

/** @typedef {{name: string, about: string, values?: import('./types').Values}} Preset */

/**
 * A list of the presets; `load` asks for them when it is shown first.
 * @param {string} id @param {string} title what stands there until one is chosen
 * @param {(preset: Preset) => void} choose
 */
export function presetList(id, title, choose) {
  /** @type {Preset[]|null|undefined} */
  let known;
  const element = h('select', { id, onchange: () => {
    const preset = known?.find(({ name }) => name === element.value);
    if (preset) choose(preset);
  } }, h('option', { value: '' }, title));
  return {
    element,
    async load() {
      if (known) return;
      known = await attempt(get('/api/presets'));
      for (const { name, about } of known ?? []) element.append(h('option', { value: name }, `${name}: ${about}`));
    },
  };
}

/**
 * A button that runs a job of the server and shows that it does.
 * @param {string} title @param {string} doing @param {() => Promise<void>} work @param {boolean} [is_main]
 */
export function jobButton(title, doing, work, is_main = true) {
  const button = h('button', { class: is_main ? 'main' : '' }, title);
  button.onclick = async () => {
    button.disabled = true;
    button.replaceChildren(h('span', { class: 'busy' }, doing));
    try {
      await work();
    } finally {
      button.disabled = false;
      button.replaceChildren(title);
    }
  };
  return button;
}
