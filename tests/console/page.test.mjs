// Drives the page in a browser, against a live group: TOUCHLINE_CONSOLE is its address. The group plays the
// synthetic match and may be disturbed; tests/console_page.rs starts one.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { open, until } from './browser.mjs';

const ADDRESS = process.env.TOUCHLINE_CONSOLE ?? 'http://127.0.0.1:7733/';

/** @type {Awaited<ReturnType<typeof open>>} */
let browser;
/** @type {import('playwright-core').Page} */
let page;

before(async () => {
  browser = await open(ADDRESS);
  page = browser.page;
});

after(() => browser?.close());

const go = (view) => page.evaluate((hash) => { location.hash = hash; }, view);
const text = (selector) => page.locator(selector).innerText();
const get = async (path) => (await fetch(new URL(path, ADDRESS))).json();
const shot = (name) => browser.shot(name);

/** Brightest value in a canvas of the live picture. */
const brightest = (which) => page.evaluate((index) => {
  const canvas = document.querySelectorAll('tl-picture canvas')[index];
  const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
  return data.reduce((most, value, at) => (at % 4 === 3 ? most : Math.max(most, value)), 0);
}, which);

test('live: the picture, and everything found on it', async () => {
  await until(async () => (await brightest(0)) > 100, 'a picture');
  await until(async () => (await brightest(1)) > 100, 'an overlay');
  const rows = page.locator('.live .list tbody tr');
  await until(async () => (await rows.count()) === 10, 'ten rows');
  await until(async () => (await rows.locator('td:last-child', { hasText: '✓' }).count()) >= 8, 'robots seen');
  await shot('live');
});

test('live: switches by mouse and key', async () => {
  const runs = page.locator('.switch', { hasText: 'Runs' });
  await runs.click();
  assert.equal(await runs.getAttribute('aria-pressed'), 'true');
  await page.keyboard.press('u');
  assert.equal(await runs.getAttribute('aria-pressed'), 'false');
});

test('live: pause, a frame back, on again', async () => {
  const kept = () => page.evaluate(async () => (await import('/page/store.js')).store.history.shown().length);
  await until(async () => (await kept()) > 5, 'pictures are kept');
  await page.keyboard.press(' ');
  const slider = page.locator('.live input[type=range]');
  const last = Number(await slider.inputValue());
  assert.ok(last > 3);
  await page.keyboard.press('ArrowLeft');
  assert.equal(Number(await slider.inputValue()), last - 1);
  await until(async () => /frame \d+/.test(await text('.live .under')), 'the number of the frame');
  await shot('paused');
  await page.locator('.live button', { hasText: 'Live' }).click();
  assert.equal(await slider.isVisible(), false);
});

test('live: zoom to the pointer, and the pixel under it', async () => {
  const box = await page.locator('.live tl-picture').boundingBox();
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  await until(async () => /RGB/.test(await text('.reading')), 'the pixel');
  const before_zoom = await page.evaluate(() => document.querySelector('tl-picture').pointer);
  await page.mouse.wheel(0, -500);
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2 + 1);
  const after_zoom = await page.evaluate(() => document.querySelector('tl-picture').pointer);
  before_zoom.forEach((at, axis) => assert.ok(Math.abs(at - after_zoom[axis]) < 2, 'the point stays under the pointer'));
  assert.equal(await page.evaluate(() => document.querySelector('tl-picture').neededScale()), 1, 'full resolution when zoomed');
  await page.mouse.dblclick(box.x + box.width / 2, box.y + box.height / 2);
});

test('match: figures, and a stage that is restarted', async () => {
  await go('match');
  await until(async () => /10/.test(await text('.tile:nth-child(1) .big')), 'robots found');
  const before_restart = (await get('/api/status')).stages.tracker.restarts;
  await page.locator('.match tr', { hasText: 'tracker' }).getByRole('button').click();
  await until(async () => (await get('/api/status')).stages.tracker.restarts > before_restart, 'a restart');
  await until(async () => /tracker/.test(await text('.events')), 'its event');
  await shot('match');
});

test('set-up: the proofs of a match that is set up', async () => {
  for (const step of ['camera', 'field', 'colors', 'robots']) {
    await go(`setup/${step}`);
    await until(async () => (await page.locator('.steps a[aria-current]').getAttribute('href')) === `#setup/${step}`, step);
    await until(async () => (await brightest(0)) > 100, 'a picture');
    await until(async () => (await page.locator('.steps a[aria-current].is-good').count()) === 1, `${step} is proven`);
    await shot(`setup-${step}`);
  }
});

test('set-up: a bound is dragged, tried, applied, taken back', async () => {
  await go('setup/colors');
  await page.locator('.colors button', { hasText: 'orange' }).click();
  const lowest = page.locator('tl-range[aria-label=Red] button').first();
  const value = Number(await lowest.getAttribute('aria-valuenow'));
  await lowest.focus();
  await page.keyboard.press('ArrowRight');
  assert.equal(Number(await lowest.getAttribute('aria-valuenow')), value + 1);
  await until(async () => /orange\.red/.test(await text('.changes')), 'the proposal');
  const { revision } = await get('/api/config');
  await page.locator('[data-test=apply]').click();
  await until(async () => (await get('/api/config')).revision > revision, 'a new revision');
  assert.equal((await get('/api/config')).values.colors[0].red[0], value + 1);
  await page.keyboard.press('Control+z');
  await until(async () => (await get('/api/config')).values.colors[0].red[0] === value, 'the old value');
});

test('the console is killed, and the page comes back by itself', async () => {
  await go('live');
  browser.is_disturbed = true;
  const { pid } = (await get('/api/status')).attendants.console;
  process.kill(pid, 'SIGKILL');
  await until(async () => /no connection/.test(await text('header')), 'the page notices');
  await until(async () => /fps/.test(await text('header .figures')), 'the page is back');
  await until(async () => (await get('/api/status')).attendants.console.pid !== pid, 'another process');
  browser.is_disturbed = false;
});

test('keys lead everywhere, and help says which', async () => {
  await page.keyboard.press('?');
  assert.ok(await page.locator('dialog').isVisible());
  await page.keyboard.press('Escape');
  for (const [key, view] of [['2', 'match'], ['3', 'setup'], ['1', 'live']]) {
    await page.keyboard.press(key);
    await until(async () => (await page.locator(`section.${view}`).count()) === 1, view);
  }
});

test('no script failed, and nothing was refused by the security policy', () => assert.deepEqual(browser.faults, []));
