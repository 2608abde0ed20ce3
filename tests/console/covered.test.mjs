// A robot whose patch is covered: the page says why it is not found. TOUCHLINE_CONSOLE is the address of a group that
// plays a recording in which a patch of TOUCHLINE_ROBOT is covered now and then.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { open, until } from './browser.mjs';

const ADDRESS = process.env.TOUCHLINE_CONSOLE ?? 'http://127.0.0.1:7733/';
const ROBOT = process.env.TOUCHLINE_ROBOT ?? 'yellow 0';
/** Generous, for a busy computer. */
const MOST_S = 5;

/** @type {Awaited<ReturnType<typeof open>>} */
let browser;

before(async () => { browser = await open(ADDRESS); });
after(() => browser?.close());

test('a page that was started for a recording begins with it', async () => {
  const { page } = browser;
  await until(async () => (await page.locator('.player .list tbody tr').count()) === 10, 'the recording, with its robots');
  await page.locator('header nav a', { hasText: 'Live' }).click();
});

test('the page says why, soon after the patch is covered', async () => {
  const { page } = browser;
  await until(async () => (await page.locator('.live .list tbody tr').count()) === 10, 'ten rows');
  /** Seconds from the capture of the first frame without the robot to its reason in the page. */
  const seconds = await page.evaluate(async (robot) => {
    const { store } = await import('/page/store.js');
    const row = () => [...document.querySelectorAll('.live .list tbody tr')].find((each) => each.dataset.key === robot);
    const is_seen = () => store.detections?.robots.some(({ name }) => name === robot);
    const next = () => new Promise((resolve) => { requestAnimationFrame(resolve); });
    while (!is_seen() || row()?.children[1].colSpan !== 1) await next();
    // Not in the first frame that the page got, but after it was seen.
    let since = null;
    for (;;) {
      if (is_seen()) since = null;
      else since ??= store.detections.time_s;
      const cell = row().children[1];
      if (since !== null && cell.colSpan === 4 && cell.textContent.length > 3) return [Date.now() / 1000 - since, cell.textContent];
      await next();
    }
  }, ROBOT);
  console.log(`${ROBOT}: "${seconds[1]}" after ${seconds[0].toFixed(2)} s`);
  await browser.shot('covered');
  assert.ok(seconds[0] < MOST_S, `after ${seconds[0]} s`);
  assert.match(seconds[1], /yellow|patch|colour|identity|identification|[a-z]{4}/);
  // Uncovered, it is found again.
  await until(async () => page.evaluate((robot) => {
    const row = [...document.querySelectorAll('.live .list tbody tr')].find((each) => each.dataset.key === robot);
    return row?.children[1].colSpan === 1;
  }, ROBOT), 'it is found again');
  assert.deepEqual(browser.faults, []);
});
