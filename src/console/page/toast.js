// Short messages in a corner: what was done, or why not.

import { ApiError } from './api.js';
import { h } from './dom.js';

const area = h('div', { class: 'toasts', role: 'status' });
document.body.append(area);

/** @param {string|ApiError} message @param {string} [help] */
export function toast(message, help) {
  const bad = message instanceof ApiError;
  const more = bad ? message.help : help;
  const box = h('div', { class: bad ? 'toast is-bad' : 'toast' },
    h('div', { class: 'grow' }, h('p', null, bad ? message.text() : message), more ? h('p', null, more) : null),
    h('button', { class: 'plain small', 'aria-label': 'Close', onclick: () => box.remove() }, '✕'),
  );
  area.append(box);
  while (area.children.length > 3) area.firstElementChild?.remove();
  setTimeout(() => box.remove(), bad ? 12_000 : 4000);
}

/** Does something, and says so if it fails. @template T @param {Promise<T>} work @returns {Promise<T|null>} */
export async function attempt(work) {
  try {
    return await work;
  } catch (error) {
    if (!(error instanceof ApiError)) throw error;
    toast(error);
    return null;
  }
}
