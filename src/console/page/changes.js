// Changes of the configuration: proposed, tried on live frames, applied without losing one, taken back,
// written to the file only on Save.

import { ApiError, post } from './api.js';
import { h, mark, replace, say } from './dom.js';
import { tryOut } from './jobs.js';
import { store } from './store.js';
import { attempt, toast } from './toast.js';

/** @typedef {import('./types').Values} Values */
/** @typedef {import('./types').Detections} Detections */

const TRY_AFTER_MS = 350;
/** How the history of the configuration words it. */
const TAKEN_BACK = /^back to revision .*fail/;

class Changes {
  constructor() {
    /** Proposed, not applied. @type {Map<string, any>} */
    this.draft = new Map();
    /** What was found with the proposal on a live frame; no detections if it could not be tried. @type {{detections: Detections|null, has_ball: boolean}|null} */
    this.tried = null;
    /** Why the proposal is refused. @type {ApiError|null} */
    this.refused = null;
    this.busy = false;
    /** Applied since the file was read or written. */
    this.applied = 0;
    /** @type {Set<() => void>} */
    this.listeners = new Set();
    /** @type {number|undefined} */
    this.timer = undefined;
    this.attempt = 0;
    this.bar = new ChangesBar(this);
    store.on('config', () => this.tell());
    store.on('connection', () => this.tell());
    store.on('status', () => {
      this.notice();
      this.bar.update();
    });
  }

  /** @param {() => void} listener */
  on(listener) {
    this.listeners.add(listener);
  }

  tell() {
    this.bar.update();
    for (const listener of this.listeners) listener();
  }

  /** Says when the supervisor took a change back because stages failed with it. @private */
  notice() {
    const newest = store.status?.configuration.history?.at(-1);
    if (!newest || newest.revision === this.newest) return;
    if (this.newest && TAKEN_BACK.test(newest.what)) {
      toast(new ApiError(422, { message: `The change was taken back: ${newest.what}`, help: 'The events in Match say which process failed, and why.' }));
    }
    this.newest = newest.revision;
  }

  newest = 0;

  /** The configuration with the proposal. @returns {Values|null} */
  get values() {
    const applied = store.config?.values;
    if (!applied) return null;
    if (!this.draft.size) return applied;
    const values = structuredClone(applied);
    for (const [key, value] of this.draft) setIn(values, key, value);
    return values;
  }

  /** @param {Record<string, any>} set @param {boolean} [at_once] tried without waiting for more */
  propose(set, at_once = false) {
    for (const [key, value] of Object.entries(set)) {
      // A key above or below another one replaces it.
      for (const known of [...this.draft.keys()]) if (known.startsWith(`${key}.`)) this.draft.delete(known);
      this.draft.set(key, value);
    }
    this.tried = null;
    this.refused = null;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.try(), at_once ? 0 : TRY_AFTER_MS);
    this.tell();
  }

  discard() {
    this.draft.clear();
    this.tried = null;
    this.refused = null;
    clearTimeout(this.timer);
    this.tell();
  }

  /** @private */
  async try() {
    if (!this.draft.size || !store.config || !store.mayChange) return;
    const attempt_number = ++this.attempt;
    const set = Object.fromEntries(this.draft);
    try {
      await post('/api/reload', { base_revision: store.config.revision, set, dry_run: true });
      const values = this.values;
      const answer = values && await tryOut(set, values).catch((error) => {
        // Another job may be running; the proposal is valid all the same.
        if (!(error instanceof ApiError) || error.status === 422) throw error;
        return null;
      });
      if (attempt_number !== this.attempt || !this.draft.size) return;
      this.tried = { detections: answer?.detections ?? null, has_ball: answer?.has_ball ?? false };
    } catch (error) {
      if (!(error instanceof ApiError)) throw error;
      if (attempt_number !== this.attempt || !this.draft.size) return;
      if (error.status === 409) await store.refresh();
      else this.refused = error;
    }
    this.tell();
  }

  /** Makes the proposal the configuration of the running group. */
  async apply() {
    if (!this.draft.size || !store.config || this.busy) return false;
    this.busy = true;
    this.tell();
    const set = Object.fromEntries(this.draft);
    const answer = await attempt(post('/api/reload', { base_revision: store.config.revision, set }));
    this.busy = false;
    if (answer) {
      this.draft.clear();
      this.tried = null;
      this.applied += 1;
      toast(`Applied: ${answer.changed?.length === 1 ? 'one key' : `${answer.changed?.length ?? 0} keys`}${answer.camera_gap ? '. The camera was opened again.' : ', no frame lost.'}`);
    }
    await store.refresh();
    this.tell();
    return Boolean(answer);
  }

  /** Drops the proposal, or takes the last applied change back. */
  async undo() {
    if (this.draft.size) return this.discard();
    if (!store.mayChange || this.busy) return;
    const answer = await attempt(post('/api/rollback', {}));
    if (answer) {
      this.applied = Math.max(0, this.applied - 1);
      toast('Taken back.', answer.changed?.map((/** @type {{key: string}} */ { key }) => key).join(', '));
    }
    await store.refresh();
  }

  async save() {
    if (!store.config || !store.mayChange) return;
    if (this.draft.size && !(await this.apply())) return;
    const path = store.config.file ? null : await askForFile();
    if (!store.config.file && !path) return;
    const answer = await attempt(post('/api/save', { path, base_hash: store.config.hash }));
    if (answer) {
      this.applied = 0;
      toast('Saved.', answer.path ?? store.config.file ?? '');
    }
    await store.refresh();
  }
}

/** @param {any} values @param {string} key @param {any} value */
export function setIn(values, key, value) {
  const parts = key.split('.');
  const last = /** @type {string} */ (parts.pop());
  let place = values;
  for (const part of parts) {
    place = Array.isArray(place) ? place.find((element) => (element.name ?? `${element.team} ${element.id}`) === part) : place?.[part];
    if (!place) return;
  }
  place[last] = value;
}

/** Name of a new file, or null. @returns {Promise<string|null>} */
function askForFile() {
  return new Promise((resolve) => {
    const input = h('input', { type: 'text', value: 'match.toml', autofocus: true, 'aria-label': 'Name of the file' });
    const done = (/** @type {string|null} */ name) => {
      dialog.remove();
      resolve(name);
    };
    const dialog = h('dialog', { onclose: () => done(null) },
      h('h2', null, 'Save the configuration'),
      h('p', { class: 'soft' }, 'The group was started without a file. The name of a new one, in the directory of the group:'),
      h('p', null, input),
      h('p', { class: 'row' }, h('span', { class: 'grow' }), h('button', { onclick: () => done(null) }, 'Cancel'), h('button', { class: 'main', onclick: () => done(input.value.trim() || null) }, 'Save')));
    input.onkeydown = (event) => event.key === 'Enter' && done(input.value.trim() || null);
    document.body.append(dialog);
    dialog.showModal();
    input.select();
  });
}

/** What is proposed or not saved, with the keys to apply, undo and save it. */
class ChangesBar {
  /** @param {Changes} changes */
  constructor(changes) {
    this.changes = changes;
    this.what = h('div', { class: 'what' });
    this.discard = h('button', { onclick: () => changes.discard() }, 'Discard');
    this.apply = h('button', { class: 'main', onclick: () => changes.apply(), 'data-test': 'apply' }, 'Apply');
    this.undo = h('button', { onclick: () => changes.undo(), title: 'Ctrl Z' }, 'Undo');
    this.save = h('button', { onclick: () => changes.save(), title: 'Ctrl S', 'data-test': 'save' }, 'Save');
    this.element = h('div', { class: 'changes', role: 'region', 'aria-label': 'Changes' }, this.what, this.discard, this.apply, this.undo, this.save);
  }

  update() {
    const { draft, tried, refused, busy } = this.changes;
    const config = store.config;
    const may = store.mayChange && store.connected;
    for (const button of [this.discard, this.apply]) button.hidden = draft.size === 0;
    for (const button of [this.undo, this.save]) button.hidden = draft.size > 0;
    this.apply.disabled = !may || Boolean(refused) || busy;
    this.undo.disabled = !may || (config?.revision ?? 1) <= 1;
    this.save.disabled = !may || !config || (config.saved && !config.file_changed);
    mark(this.save, 'main', !this.save.disabled);
    mark(this.what, 'bad', Boolean(refused));
    if (draft.size) {
      const keys = [...draft.keys()].map((key) => key.replace(/^colors\.|^robots\./, '')).join(', ');
      if (refused) return replace(this.what, `✕ ${refused.text()}${refused.help ? ` ${refused.help}` : ''}`);
      const found = store.status?.found;
      const then = tried?.detections ? new Set(tried.detections.robots.filter((robot) => robot.identity !== null).map((robot) => robot.name)).size : null;
      replace(this.what, h('b', null, busy ? 'Being applied: ' : 'Proposed: '),
        then === null ? h('span', { class: 'soft' }, tried ? 'valid' : 'being tried on a live frame …')
          : h('span', { class: then >= (found?.robots ?? 0) ? 'good' : 'warn' }, `${found?.robots ?? '–'} robots found now, ${then} with it${tried?.has_ball ? ' and the ball' : ', no ball'}`),
        ' · ', keys);
      return;
    }
    const file = config?.file ? config.file.split('/').at(-1) : null;
    say(this.save, file ? `Save to ${file}` : 'Save as …');
    if (!config) return say(this.what, 'The configuration is being read …');
    if (!store.mayChange) return say(this.what, `Revision ${config.revision}. This page may only watch.`);
    const newest = store.status?.configuration.history?.at(-1);
    if (newest?.revision === config.revision && TAKEN_BACK.test(newest.what)) return say(this.what, `! Revision ${config.revision}: ${newest.what}.`);
    if (config.file_changed) return say(this.what, `! ${file} was changed by another program. Reload it with touchline reload, or save over it.`);
    say(this.what, config.saved ? `Revision ${config.revision}, as in ${file ?? 'the preset'}.` : `Revision ${config.revision} is in use, and not saved to ${file ?? 'a file'} yet.`);
  }
}

export const changes = new Changes();
