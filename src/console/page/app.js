// The frame of the page: tabs, the line that says what needs a human, connection, keys, light and dark.

import { ApiError, post } from './api.js';
import { h, mark, number, replace, say } from './dom.js';
import { LiveView } from './live-view.js';
import { MatchView } from './match-view.js';
import { need } from './needs.js';
import { SWITCHES } from './overlay.js';
import { RecordingsView } from './recordings-view.js';
import { SetupView } from './setup-view.js';
import { store } from './store.js';
import { toast } from './toast.js';

/** @typedef {{element: HTMLElement, show: (part: string) => void, hide: () => void, key?: (event: KeyboardEvent) => boolean}} View */

const TABS = /** @type {const} */ ([['live', 'Live'], ['match', 'Match'], ['setup', 'Set-up'], ['recordings', 'Recordings']]);

/** @type {Record<string, () => View>} */
const MAKE = { live: () => new LiveView(), match: () => new MatchView(), setup: () => new SetupView(), recordings: () => new RecordingsView() };

/** @type {Map<string, View>} */
const views = new Map();
/** @type {View|null} */
let current = null;
let robots_missing_since = 0;

const links = TABS.map(([name, title], index) => h('a', { href: `#${name}`, title: `Key ${index + 1}` }, title));
const group = h('small', null);
const connection = h('b', null, '…');
const robots = h('b', null, '–');
const delay = h('b', null, '–');
const alert_text = h('b', null);
const alert_todo = h('span', null);
const alert_sign = h('span', { class: 'sign', 'aria-hidden': 'true' }, '!');
const alert_button = h('button', { class: 'small', onclick: () => act() });
const alert = h('div', { class: 'alert', role: 'alert', hidden: true }, alert_sign, alert_text, alert_todo, h('span', { class: 'grow' }), alert_button);
const main = h('main', null);
const rights = h('span', { hidden: true }, 'watching only');

document.body.append(
  h('header', { class: 'bar' },
    h('span', { class: 'name' }, 'Touchline', group),
    h('nav', { 'aria-label': 'Views' }, links),
    h('span', { class: 'grow' }),
    h('div', { class: 'figures' },
      rights,
      h('span', null, robots, ' found'),
      h('span', null, delay, ' ms'),
      h('span', null, connection),
    ),
    h('button', { class: 'plain', title: 'Light or dark (key D)', 'aria-label': 'Light or dark', onclick: switchTheme }, '◐'),
    h('button', { class: 'plain', title: 'Keys and signs (key ?)', 'aria-label': 'Help', onclick: help }, '?'),
  ),
  alert,
  main,
);

/** @type {import('./needs.js').Need|null} */
let needed = null;

async function act() {
  const action = needed?.action;
  if (action?.go) location.hash = action.go;
  if (!action?.restart) return;
  try {
    await post('/api/restart', { process: action.restart });
    toast(`The ${action.restart} is being restarted.`);
  } catch (error) {
    if (error instanceof ApiError) toast(error);
    else throw error;
  }
}

function route() {
  const [name, ...rest] = location.hash.slice(1).split('/');
  const part = rest.join('/');
  const known = MAKE[name] ? name : 'live';
  let view = views.get(known);
  if (!view) {
    view = MAKE[known]();
    views.set(known, view);
  }
  if (view !== current) {
    current?.hide();
    replace(main, view.element);
    current = view;
  }
  view.show(part);
  links.forEach((link, index) => {
    if (TABS[index][0] === known) link.setAttribute('aria-current', 'page');
    else link.removeAttribute('aria-current');
  });
  document.title = `Touchline – ${TABS.find(([tab]) => tab === known)?.[1]}`;
}

/** A page that was started to look at a recording begins with it. */
function lead() {
  if (store.hello?.alone && store.hello.source.startsWith('recording:') && !location.hash) location.hash = 'recordings';
}

/** The figures in the bar, and the line below it. */
function update() {
  const { status, hello, connected } = store;
  const found = status?.found;
  if (found && (found.robots > 0 || !connected)) robots_missing_since = 0;
  else if (found) robots_missing_since ||= performance.now();
  say(group, hello ? `${hello.instance} · ${hello.source}` : '');
  say(robots, found ? `${found.robots}/${found.robots_configured}${found.ball ? ' + ball' : ''}` : '–');
  say(delay, number(latest() === null ? null : /** @type {number} */ (latest()) / 1000, 1));
  say(connection, connected ? `● ${number(status?.rate.captured, 0)} fps` : '○ no connection');
  mark(connection, 'bad', !connected);
  rights.hidden = !hello || store.mayChange;
  needed = need({
    connected, met: store.met, status, lost_for_s: (performance.now() - store.lost_ms) / 1000,
    robots_missing_s: robots_missing_since ? (performance.now() - robots_missing_since) / 1000 : 0,
  });
  alert.hidden = !needed;
  if (!needed) return;
  mark(alert, 'is-warn', needed.level === 'warn');
  say(alert_text, needed.what);
  say(alert_todo, needed.todo);
  const action = needed.action;
  const is_here = action?.go && location.hash === `#${action.go}`;
  alert_button.hidden = !action || Boolean(is_here) || Boolean(action.restart && !store.mayChange);
  if (action) say(alert_button, action.restart ? action.label : `Go to ${action.label}`);
}

function latest() {
  return store.latencies.at(-1)?.p50.filter ?? null;
}

function switchTheme() {
  const light = document.documentElement.dataset.theme !== 'light';
  setTheme(light ? 'light' : 'dark');
  try {
    localStorage.setItem('theme', light ? 'light' : 'dark');
  } catch {
    // Without storage the choice lasts until the page is closed.
  }
}

/** @param {string} theme */
function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  store.tell('scene');
}

function storedTheme() {
  try {
    return localStorage.getItem('theme');
  } catch {
    return null;
  }
}

/** @type {HTMLDialogElement|null} */
let dialog = null;

function help() {
  if (dialog?.open) return dialog.close();
  const keys = [
    ['1 2 3 4', 'Live, Match, Set-up, Recordings'], ['D', 'light or dark'], ['?', 'this page'], ['Space', 'pause, and on again'],
    ['← →', 'a frame back, forward'], ['+ − 0', 'zoom in, out, whole picture'], ['Ctrl Z', 'take the last change back'], ['Ctrl S', 'save to the file'],
    ['K', 'mark this moment'],
    ...SWITCHES.map(([, key, title]) => [key, title.toLowerCase()]),
  ];
  dialog = h('dialog', { onclose: () => dialog?.remove() },
    h('h2', null, 'Keys and signs'),
    h('div', { class: 'keys' }, keys.flatMap(([key, what]) => [h('kbd', null, key), h('span', null, what)])),
    h('p', { class: 'row' }, h('span', { class: 'robot' }, 'Y3'), 'yellow team, square ', h('span', { class: 'robot is-blue' }, 'B0'), 'blue team, round ',
      h('span', { class: 'robot is-away' }, 'Y1'), 'not seen now'),
    h('p', { class: 'soft' }, 'Solid outline: seen in this frame. Dashed: predicted only. ✕ with words: a candidate that was rejected, and why.'),
    h('p', { class: 'row' }, h('span', { class: 'grow' }), h('button', { class: 'main', autofocus: true, onclick: () => dialog?.close() }, 'Close')),
  );
  document.body.append(dialog);
  dialog.showModal();
}

// A button that was clicked would take the space bar from then on, which pauses.
document.addEventListener('click', (event) => {
  const button = /** @type {Element} */ (event.target).closest('button:not([role=slider])');
  if (event.detail > 0 && button instanceof HTMLElement) button.blur();
});

document.addEventListener('keydown', (event) => {
  const target = /** @type {HTMLElement} */ (event.target);
  if (target.matches('input:not([type=range]):not([type=checkbox]), select, textarea') || dialog?.open) return;
  // With the keyboard's focus on a button, the space bar presses it.
  if (event.key === ' ' && target.matches('button:focus-visible, a:focus-visible, summary')) return;
  if (current?.key?.(event)) return event.preventDefault();
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const tab = TABS[Number(event.key) - 1];
  if (tab) location.hash = tab[0];
  else if (event.key === '?') help();
  else if (event.key === 'd') switchTheme();
});

setTheme(storedTheme() ?? (matchMedia('(prefers-color-scheme: light)').matches ? 'light' : 'dark'));
addEventListener('hashchange', route);
store.on('status', update);
store.on('connection', update);
store.on('hello', update);
store.on('hello', lead);
setInterval(update, 500);
store.start();
route();
update();
