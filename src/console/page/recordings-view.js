// Recordings: the list of them, or one that is opened.

import { ApiError, get } from './api.js';
import { bytes, h, keyed, replace, say } from './dom.js';
import { RecordingPlayer } from './recording-player.js';
import { store } from './store.js';

/** @typedef {import('./types').ListedRecording} Listed */

const LOOK_MS = 3000;

export class RecordingsView {
  constructor() {
    this.rows = h('tbody', null);
    this.table = h('table', null, h('thead', null, h('tr', null, h('th', null, 'Recording'), h('th', null, 'Made'), h('th', { class: 'n' }, 'Size'), h('th', null, 'Directory'))), this.rows);
    this.empty = h('div', { class: 'empty' }, h('b', null, 'No recordings yet'),
      h('span', null, 'Start one in ', h('a', { href: '#match' }, 'Match'), ', or with: touchline record FILE.mcap'),
      h('span', null, 'Those of other directories are listed when the configuration names them: [console] recordings'));
    this.places = h('p', { class: 'soft' });
    this.list = h('section', { class: 'recordings' }, h('div', { class: 'panel' }, this.table, this.empty, this.places));
    this.element = h('section', { class: 'recordings-view' }, this.list);
    /** @type {RecordingPlayer|null} */
    this.player = null;
    this.visible = false;
    /** Whether the played recording was opened by itself. */
    this.led = false;
    setInterval(() => this.visible && !this.player && this.look(), LOOK_MS);
  }

  /** @param {string} part place and name of a recording, or nothing */
  show(part) {
    this.visible = true;
    const at = part.indexOf('/');
    if (at < 0) {
      this.close();
      replace(this.element, this.list);
      this.look();
      return;
    }
    const [place, name] = [part.slice(0, at), decoded(part.slice(at + 1))];
    if (this.player?.is(place, name)) return;
    this.close();
    this.player = new RecordingPlayer(place, name);
    replace(this.element, this.player.element);
  }

  hide() {
    this.visible = false;
    this.close();
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    return this.player?.key(event) ?? false;
  }

  /** @private */
  close() {
    this.player?.close();
    this.player = null;
  }

  /** @private */
  async look() {
    /** @type {import('./types').RecordingList} */
    let answer;
    try {
      answer = await get('/api/recordings');
    } catch (error) {
      // It is asked again soon.
      if (error instanceof ApiError) return;
      throw error;
    }
    if (!this.visible || this.player) return;
    const { recordings, directories, played } = answer;
    const is_played = (/** @type {Listed} */ it) => `${it.directory}/${it.name}` === played;
    const now_playing = recordings.find(is_played);
    if (now_playing && store.hello?.alone && !this.led) {
      // The page was started to look at it.
      this.led = true;
      location.hash = addressOf(now_playing);
      return;
    }
    this.led = true;
    this.table.hidden = !recordings.length;
    this.empty.hidden = recordings.length > 0;
    say(this.places, `Looked for in ${directories.join(', ')}`);
    keyed(this.rows, recordings, addressOf, (it) => h('tr', { class: 'clickable', onclick: () => { location.hash = addressOf(it); } },
      h('td', null, h('a', { href: addressOf(it) }, it.name), ' ', h('span', { class: 'soft' })), h('td', null), h('td', { class: 'n' }), h('td', { class: 'soft' }, it.directory)),
    (row, it) => {
      const path = `${it.directory}/${it.name}`;
      say(row.children[0].children[1], path === store.status?.recording?.path ? 'is being recorded' : is_played(it) ? 'is being played' : '');
      say(row.children[1], new Date(it.modified_s * 1000).toLocaleString('en-GB'));
      say(row.children[2], bytes(it.bytes));
    });
  }
}

/** @param {string} text */
function decoded(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    // Typed by hand; there is no such recording.
    return text;
  }
}

/** @param {Listed} it */
function addressOf(it) {
  return `#recordings/${it.place}/${encodeURIComponent(it.name)}`;
}
