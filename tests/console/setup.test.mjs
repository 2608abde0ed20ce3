// Sets a pitch up in the browser, from a preset that fits nothing of it. TOUCHLINE_CONSOLE is the address of a
// group that paints the pitch of tests/console_page.rs; its configuration is replaced by the preset first.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { open, until } from './browser.mjs';

const ADDRESS = process.env.TOUCHLINE_CONSOLE ?? 'http://127.0.0.1:7733/';
/** Of the pitch that is painted. */
const SIZES = { length_mm: 1900, width_mm: 1500, goal_width_mm: 360, goal_depth_mm: 120, center_circle_radius_mm: 170 };
const MOST_ACTIONS = 40;

/** @type {Awaited<ReturnType<typeof open>>} */
let browser;
let actions = 0;

const get = async (path) => (await fetch(new URL(path, ADDRESS))).json();

before(async () => {
  const origin = new URL(ADDRESS).origin;
  const { revision, values } = await get('/api/config');
  // With another camera or another match, the grabber would be replaced and paint the preset's pitch.
  const text = `preset = "mirosot-5v5"\n[camera]\nfps = ${values.camera.fps}\n[console]\nlisten = "${values.console.listen}"\n`
    + `[synthetic]\nmax_speed_mm_s = ${values.synthetic.max_speed_mm_s}\n`;
  const answer = await fetch(new URL('/api/reload', ADDRESS), {
    method: 'POST', headers: { origin, 'content-type': 'application/json' }, body: JSON.stringify({ base_revision: revision, text }),
  });
  assert.ok(answer.ok, await answer.text());
  await until(async () => (await get('/api/status')).configuration.revision === revision + 1, 'the configuration of the preset');
  browser = await open(ADDRESS);
});

after(async () => {
  await browser?.shot('setup-end');
  await browser?.close();
});

test('from a preset that does not fit to all robots and the ball', async () => {
  const { page, shot } = browser;
  /** A click of the mouse, at the place where the browser shows it. */
  const click = async (locator, options = {}) => {
    actions += 1;
    await locator.scrollIntoViewIfNeeded();
    const box = await locator.boundingBox();
    await until(async () => locator.isEnabled(), `${locator} can be clicked`);
    await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2, options);
  };
  const step = (name) => click(page.locator(`.steps a[href='#setup/${name}']`));
  /** A job has three minutes, and finding the field takes two jobs. */
  const proposed = async (key) => {
    const answer = await until(async () => {
      if ((await page.locator('.changes').innerText()).includes(key)) return 'proposed';
      const refusals = await page.locator('.toast.is-bad').allInnerTexts();
      return refusals.join();
    }, `${key} is proposed`, 300_000);
    assert.equal(answer, 'proposed');
  };
  const apply = async () => {
    const { revision } = await get('/api/config');
    await click(page.locator('[data-test=apply]'));
    await until(async () => (await get('/api/config')).revision > revision, 'a new revision');
  };
  const began_ms = performance.now();
  await click(page.locator('header nav a', { hasText: 'Set-up' }));
  await step('field');
  for (const [key, value] of Object.entries(SIZES)) {
    // A click into the number marks all of it, and typing replaces it.
    await click(page.locator(`[id="field.${key}"]`), { clickCount: 3 });
    actions += 1;
    await page.keyboard.type(`${value}\t`);
  }
  await proposed('field.length_mm');
  await click(page.getByRole('button', { name: 'Find the field' }));
  await proposed('geometry.points');
  await shot('done-field');
  await apply();

  await step('robots');
  // The open list is drawn by the system, not by the page: no mouse can be led to it here.
  actions += 2;
  await page.locator('#layout').selectOption('mirosot-triangles');
  await proposed('patches');
  await apply();

  await step('colors');
  await click(page.getByRole('button', { name: 'Learn the colours' }));
  const { found: before_learning } = await get('/api/status');
  assert.ok(before_learning.robots < 10, 'with the colours of the preset robots are missing');
  await proposed('colors');
  await shot('done-colors');
  await apply();
  await until(async () => {
    const { found } = await get('/api/status');
    return found.robots === 10 && found.ball;
  }, 'ten robots and the ball');

  await step('robots');
  await until(async () => (await page.locator('.top.is-good').count()) === 10, 'all robots are ticked off');
  await shot('done-robots');
  await step('check');
  await click(page.getByRole('button', { name: /Check/ }));
  await until(async () => /Check again/.test(await page.locator('.setup .side').innerText()), 'the check is over');
  await shot('done-check');

  await click(page.locator('[data-test=save]'));
  const config = await until(async () => {
    const now = await get('/api/config');
    return now.saved && now;
  }, 'the configuration is saved');
  const { history } = (await get('/api/status')).configuration;
  assert.ok(!history.some(({ what }) => what.startsWith('back to')), JSON.stringify(history));
  assert.equal(config.values.field.length_mm, SIZES.length_mm);
  console.log(`${actions} actions, ${((performance.now() - began_ms) / 1000).toFixed(0)} s; ${before_learning.robots} robots before the colours were learned`);
  assert.ok(actions < MOST_ACTIONS, `${actions} actions`);
  assert.deepEqual(browser.faults, []);
});
