// A browser with a fresh profile, and waiting for what it shows.

import assert from 'node:assert/strict';
import { mkdirSync, mkdtempSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { chromium } from 'playwright-core';

/** Pictures of every view, if a directory is named. */
const SHOTS = process.env.TOUCHLINE_SCREENSHOTS;
const FLAGS = [
  '--headless', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking', '--disable-component-update',
  '--disable-sync', '--enable-unsafe-swiftshader',
];

/** @param {string} address */
export async function open(address) {
  const profile = mkdtempSync(join(tmpdir(), 'touchline-browser-'));
  const context = await chromium.launchPersistentContext(profile, {
    executablePath: process.env.TOUCHLINE_CHROMIUM ?? '/usr/bin/chromium', args: FLAGS, viewport: { width: 1440, height: 900 }, colorScheme: 'dark',
  });
  const page = context.pages()[0] ?? (await context.newPage());
  page.setDefaultTimeout(30_000);
  const browser = {
    page,
    /** Errors of scripts, and what the security policy refused. @type {string[]} */
    faults: [],
    /** While the server is away on purpose, requests fail. */
    is_disturbed: false,
    async shot(name) {
      if (!SHOTS) return;
      mkdirSync(SHOTS, { recursive: true });
      await page.screenshot({ path: join(SHOTS, `${name}.png`) });
    },
    /** @param {'light'|'dark'} theme */
    async setTheme(theme) {
      await page.evaluate((name) => { document.documentElement.dataset.theme = name; }, theme);
    },
    async close() {
      await context.close();
      rmSync(profile, { recursive: true, force: true });
    },
  };
  page.on('pageerror', (error) => browser.faults.push(String(error.stack)));
  page.on('console', (message) => {
    const text = message.text();
    const is_expected = browser.is_disturbed || /WebSocket|Failed to load resource/.test(text);
    if (/Content Security Policy/i.test(text) || (message.type() === 'error' && !is_expected)) browser.faults.push(text);
  });
  await page.goto(address);
  return browser;
}

/** Waits until a question about the page or the group is answered with something true. */
export async function until(question, what, patience_ms = 60_000) {
  const deadline = Date.now() + patience_ms;
  for (;;) {
    const answer = await question().catch(() => null);
    if (answer) return answer;
    assert.ok(Date.now() < deadline, `not within ${patience_ms / 1000} s: ${what}`);
    await new Promise((resolve) => { setTimeout(resolve, 50); });
  }
}
