// Recordings in the browser: made, opened, scrubbed, played, compared, exported. TOUCHLINE_CONSOLE is the address of a
// group that plays the synthetic match.

import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
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

const get = async (path) => (await fetch(new URL(path, ADDRESS))).json();
const frame = async () => Number(/frame (\d+)/.exec(await page.locator('.player .under').innerText())?.[1]);
const index = async () => Number(/(\d+) of \d+/.exec(await page.locator('.player .under').innerText())?.[1]);
const time = async () => Number(await page.locator('tl-timeline').getAttribute('aria-valuenow'));
/** Brightest value of a canvas of one of the pictures: 0 the picture, 1 the overlay. */
const brightest = (picture, which) => page.evaluate(([picture_index, index_of]) => {
  const canvas = document.querySelectorAll('.player tl-picture')[picture_index].querySelectorAll('canvas')[index_of];
  if (!canvas.width || !canvas.height) return 0;
  const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
  return data.reduce((most, value, at) => (at % 4 === 3 ? most : Math.max(most, value)), 0);
}, [picture, which]);

test('without recordings the page says what to do', async () => {
  await page.locator('header nav a', { hasText: 'Recordings' }).click();
  await until(async () => /No recordings yet/.test(await page.locator('.recordings').innerText()), 'the empty list');
  await browser.shot('recordings-none');
});

test('a recording is made in Match, with a mark and a changed configuration', async () => {
  await until(async () => (await get('/api/status')).found.robots === 10, 'all robots are found');
  await page.locator('header nav a', { hasText: 'Match' }).click();
  await page.getByRole('button', { name: 'Start recording' }).click();
  await until(async () => (await get('/api/status')).recording?.bytes > 1e6, 'it grows');
  await page.getByRole('button', { name: 'Mark' }).click();
  const { revision } = await get('/api/config');
  const answer = await fetch(new URL('/api/reload', ADDRESS), {
    method: 'POST', headers: { origin: new URL(ADDRESS).origin, 'content-type': 'application/json' },
    body: JSON.stringify({ base_revision: revision, set: { 'filter.actuation_delay_ms': 61 } }),
  });
  assert.ok(answer.ok, await answer.text());
  const { bytes } = (await get('/api/status')).recording;
  await until(async () => (await get('/api/status')).recording.bytes > bytes + 16e6, 'it grows on');
  await page.getByRole('button', { name: 'End recording' }).click();
  await until(async () => (await get('/api/status')).recording === null, 'it is complete');
});

test('it is opened, and every frame has its overlay', async () => {
  await page.getByRole('link', { name: 'Look at recordings' }).click();
  await page.locator('.recordings tbody tr').first().click();
  await until(async () => (await brightest(0, 0)) > 100, 'a picture');
  await until(async () => (await brightest(0, 1)) > 100, 'an overlay');
  await until(async () => (await page.locator('.player .list tbody tr').count()) === 10, 'ten rows');
  await until(async () => /marked/.test(await page.locator('.player .flags').innerText()), 'the mark');
  assert.match(await page.locator('.player .flags').innerText(), /configuration 2: filter\.actuation_delay_ms/);
  await browser.shot('recording');
});

test('scrubbed by mouse, stepped by key, played', async () => {
  const line = await page.locator('tl-timeline').boundingBox();
  await page.mouse.click(line.x + line.width / 2, line.y + line.height / 2);
  const whole = Number(await page.locator('tl-timeline').getAttribute('aria-valuemax'));
  await until(async () => (await time()) > 0.4 * whole, 'the middle');
  await page.mouse.move(line.x + line.width / 4, line.y + line.height / 2);
  await page.mouse.down();
  for (let part = 25; part <= 75; part += 5) await page.mouse.move(line.x + (line.width * part) / 100, line.y + line.height / 2);
  await page.mouse.up();
  await until(async () => Math.abs((await time()) - 0.75 * whole) < 0.02 * whole, 'three quarters');
  const [at, before_step] = [await index(), await frame()];
  await page.keyboard.press('ArrowLeft');
  await until(async () => (await index()) === at - 1, 'a frame back');
  assert.ok((await frame()) < before_step);
  await page.keyboard.press('Home');
  await until(async () => (await index()) === 1, 'the first frame');
  await page.locator('.player select[aria-label=Speed]').selectOption('4');
  await page.keyboard.press(' ');
  await until(async () => (await index()) > 10, 'it plays');
  await page.keyboard.press(' ');
  const paused = await index();
  await page.keyboard.press('ArrowRight');
  await until(async () => (await index()) > paused, 'a frame on');
});

test('another configuration beside it, robot by robot', async () => {
  await page.getByLabel('Compare with').first().selectOption('file');
  const [chooser] = await Promise.all([page.waitForEvent('filechooser'), page.getByRole('button', { name: 'Compare', exact: true }).click()]);
  const { text } = await get('/api/config');
  // One robot fewer, and the ball in another colour.
  const other = text.replace(/(\[ball\][^[]*?color = )"[a-z]+"/s, '$1"green"');
  assert.notEqual(other, text);
  await chooser.setFiles({ name: 'green-ball.toml', mimeType: 'application/toml', buffer: Buffer.from(other) });
  await until(async () => /green-ball\.toml: \d+ frames; .*differ/.test(await page.locator('.player .compare').innerText()), 'the comparison', 120_000);
  await until(async () => (await brightest(1, 1)) > 100, 'the other overlay');
  const ball = page.locator('.player .compare tbody tr', { hasText: 'Ball' });
  assert.match(await ball.innerText(), /not found|found elsewhere/);
  await browser.shot('recording-compared');
  await page.getByRole('button', { name: 'Difference ▶' }).click();
  await browser.setTheme('light');
  await browser.shot('recording-compared-light');
  await browser.setTheme('dark');
});

test('a picture and a table are saved', async () => {
  const [picture] = await Promise.all([page.waitForEvent('download'), page.getByRole('button', { name: 'Save picture' }).click()]);
  assert.match(picture.suggestedFilename(), /\.png$/);
  const bytes = readFileSync(await picture.path());
  assert.equal(bytes.subarray(1, 4).toString(), 'PNG');
  const [table] = await Promise.all([page.waitForEvent('download'), page.getByRole('link', { name: 'Save CSV' }).click()]);
  assert.match(readFileSync(await table.path(), 'utf8'), /^source,seq,/);
  await page.setViewportSize({ width: 1024, height: 768 });
  await browser.shot('recording-tablet');
  await page.setViewportSize({ width: 1280, height: 800 });
  await browser.shot('recording-1280');
});

test('no script failed, and nothing was refused by the security policy', () => assert.deepEqual(browser.faults, []));
