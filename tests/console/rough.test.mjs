// The page under rough conditions: stages that die, a slow line. TOUCHLINE_CONSOLE is the address of a group that
// plays the synthetic match; tests/console_page.rs starts one.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { open, until } from './browser.mjs';

const ADDRESS = process.env.TOUCHLINE_CONSOLE ?? 'http://127.0.0.1:7733/';
const STAGES = ['classifier', 'tracker', 'filter'];
const ROUNDS = 9;
/** 2 Mbit/s. */
const SLOW_BYTES_S = 250_000;

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
const pause = (ms) => new Promise((resolve) => { setTimeout(resolve, ms); });

/** What the page has shown so far: the newest frame of the overlay, and the number of pictures. */
const shown = () => page.evaluate(async () => {
  const { store } = await import('/page/store.js');
  return { seq: store.detections?.seq ?? 0, pictures: globalThis.pictures_shown ?? 0, fps: store.model?.picture.fps ?? 0 };
});

/** From now on the page counts the pictures that it draws. */
const countPictures = () => page.evaluate(() => {
  globalThis.pictures_shown = 0;
  const picture = document.querySelector('.live tl-picture');
  const show = picture.show.bind(picture);
  picture.show = (each) => {
    globalThis.pictures_shown += 1;
    return show(each);
  };
});

test('a stage is killed every second: the page shows it and never stops', async () => {
  await until(async () => (await page.locator('.live .list tbody tr').count()) === 10, 'the robots');
  await until(async () => (await get('/api/status')).found.robots === 10, 'all robots are found');
  const before_all = await get('/api/status');
  const restarts = (status) => STAGES.reduce((sum, stage) => sum + status.stages[stage].restarts, 0);
  for (let round = 0; round < ROUNDS; round += 1) {
    const stage = STAGES[round % STAGES.length];
    const status = await until(async () => {
      const now = await get('/api/status');
      return now.complete && now.stages[stage].processes.some(({ state }) => state === 'active') && now;
    }, `a ${stage}`);
    const { pid } = status.stages[stage].processes.find(({ state }) => state === 'active');
    const { seq } = await shown();
    process.kill(pid, 'SIGKILL');
    await until(async () => (await get('/api/status')).stages[stage].restarts > status.stages[stage].restarts, `another ${stage}`);
    // Half a second of frames after the kill have been drawn.
    await until(async () => (await shown()).seq > seq + 20, `frames after the death of the ${stage}`);
    await pause(500);
  }
  await page.evaluate(() => { location.hash = 'match'; });
  const after_all = await get('/api/status');
  assert.ok(restarts(after_all) >= restarts(before_all) + ROUNDS);
  assert.equal(after_all.frames.missing_in_world, 0, 'no frame was lost');
  for (const stage of STAGES) {
    await until(async () => (await page.locator('.match .events', { hasText: stage }).count()) > 0, `the events name the ${stage}`);
  }
  await browser.shot('stages-killed');
  await page.evaluate(() => { location.hash = 'live'; });
  await until(async () => (await page.locator('.live .list td:last-child', { hasText: '✓' }).count()) >= 8, 'robots are seen again');
});

test('on a line of 2 Mbit/s the overlay stays current, and pictures get fewer', async () => {
  await countPictures();
  const pictures = async (seconds) => {
    const from = await shown();
    await pause(1000 * seconds);
    return ((await shown()).pictures - from.pictures) / seconds;
  };
  const usual = await pictures(3);
  const cdp = await page.context().newCDPSession(page);
  await cdp.send('Network.enable');
  await cdp.send('Network.emulateNetworkConditions', { offline: false, latency: 20, downloadThroughput: SLOW_BYTES_S, uploadThroughput: SLOW_BYTES_S });
  // What was on its way has come.
  await pause(1000);
  const late = [];
  const slow = pictures(6);
  for (let look = 0; look < 20; look += 1) {
    await pause(250);
    const newest = (await get('/api/status')).frames.captured;
    const now = await shown();
    late.push((newest - now.seq) / now.fps);
  }
  const [few, middle] = [await slow, late.sort((a, b) => a - b)[late.length >> 1]];
  console.log(`pictures a second: ${usual.toFixed(1)}, on the slow line ${few.toFixed(1)}; overlay behind by ${middle.toFixed(2)} s, at most ${late.at(-1).toFixed(2)} s`);
  assert.ok(few > 0 && few < 0.8 * usual, `${few} of ${usual} pictures a second`);
  // The report that tells the newest frame is up to a second old itself.
  assert.ok(middle < 1, `the overlay is ${middle} s behind`);
  assert.equal(await page.locator('header', { hasText: 'no connection' }).count(), 0);
  await browser.shot('slow-line');
  await cdp.send('Network.emulateNetworkConditions', { offline: false, latency: 0, downloadThroughput: -1, uploadThroughput: -1 });
});

test('no script failed, and nothing was refused by the security policy', () => assert.deepEqual(browser.faults, []));
