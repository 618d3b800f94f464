/**
 * The page in a real browser, against real servers: `npm run browser`, with the programs built by `cargo build` and
 * a chromium in the path (or named by CHROMIUM). `-- --pictures DIR` also takes the documents' pictures,
 * `-- --only-capture` tries the page of the camera alone.
 */

import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { mkdtempSync, rmSync } from 'node:fs';
import { createRequire } from 'node:module';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { pathToFileURL } from 'node:url';
import { chromium } from 'playwright-core';
import { access } from './access.mjs';
import { capture } from './capture.mjs';
import { browserPath, FLAGS } from './chromium.mjs';
import { demonstration, emptyServer, PROGRAMS } from './servers.mjs';

const AXE = createRequire(import.meta.url).resolve('axe-core/axe.min.js');
const FRAMES = Number(process.env.FRAMES ?? 150);
const pictures = process.argv.includes('--pictures') ? process.argv[process.argv.indexOf('--pictures') + 1] : null;

let n_passed = 0;
const complaints = [];

function passed(what) {
  n_passed += 1;
  console.log(`ok - ${what}`);
}

async function newPage(browser, options) {
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, ...options });
  const page = await context.newPage();
  page.on('console', (message) => message.type() === 'error' && complaints.push(message.text()));
  page.on('pageerror', (error) => complaints.push(error.message));
  return page;
}

/** No serious fault of accessibility, and nothing wider than the window. */
async function check(page, what) {
  // The policy lets no foreign script in; this one is put in by the browser itself.
  await page.evaluate(await (await import('node:fs/promises')).readFile(AXE, 'utf8'));
  const { violations } = await page.evaluate(() => globalThis.axe.run());
  const serious = violations.filter(({ impact }) => impact === 'serious' || impact === 'critical');
  const told = serious.map(({ id, nodes }) => `${id}: ${nodes.map((node) => node.html).join(' ')}`);
  assert.deepEqual(told, [], what);
  const [wide, window] = await page.evaluate(() => [document.scrollingElement.scrollWidth, innerWidth]);
  assert.ok(wide <= window, `${what}: ${wide} pixels wide in a window of ${window}`);
  passed(`${what}: no serious fault of accessibility, nothing too wide`);
}

async function picture(page, name) {
  if (pictures) await page.screenshot({ path: join(pictures, `viewer-${name}.png`) });
}

const figure = (page, name) =>
  page.evaluate((wanted) => [...document.querySelectorAll('dt')].find((term) => term.textContent === wanted)?.nextElementSibling?.textContent, name);
const number = async (page, name) => Number((await figure(page, name))?.replace(/\D/g, '') || 0);
/** Waits until a figure has this value: figures are drawn with the next refresh of the screen. */
const becomes = (page, name, value) =>
  page.waitForFunction(([name, value]) => [...document.querySelectorAll('dt')].find((term) => term.textContent === name)?.nextElementSibling.textContent.replace(/\D/g, '') === value, [name, String(value)], { timeout: 20_000 });

async function emptyAndAway(browser) {
  const server = await emptyServer();
  try {
    const page = await newPage(browser, { colorScheme: 'light' });
    await page.goto(server.url);
    await page.getByText('No sessions yet.').waitFor();
    await check(page, 'empty list');
    await picture(page, 'empty');
    await page.goto(`${server.url}/#/s/nobody`);
    await page.getByText('There is no such session').waitFor();
    passed('a session that is not there is told');
    await page.goto(`${server.url}/#/`);
    await page.getByText('No sessions yet.').waitFor();
    await server.stop();
    await page.getByText('The server does not answer').waitFor();
    await server.start();
    await page.getByText('No sessions yet.').waitFor();
    passed('the list comes back with the server');
    await page.context().close();
    complaints.length = 0; // The browser itself complains about a server that is away.
  } finally {
    await server.remove();
  }
}

async function live(page, url) {
  await page.goto(url);
  const card = page.locator('.cards a');
  await card.waitFor({ timeout: 120_000 });
  await card.focus();
  await page.keyboard.press('Enter');
  await page.waitForURL(/#\/s\//);
  await page.waitForFunction(() => document.querySelector('.frame-text')?.textContent.includes('initialising'));
  passed('a stream is followed while there is no map, with the reason');
  await page.waitForFunction(() => document.querySelectorAll('dt').length > 10);
  await page.waitForFunction(() => [...document.querySelectorAll('h2')].some((title) => title.textContent.startsWith('Frame ')));
  passed('the newest image is shown');
  await page.waitForFunction(() => Number([...document.querySelectorAll('dt')].find((term) => term.textContent === 'Keyframes')?.nextElementSibling.textContent) > 3, null, { timeout: 120_000 });
  await picture(page, 'live');
  await page.context().setOffline(true);
  await new Promise((resolve) => setTimeout(resolve, 2000));
  await page.context().setOffline(false);
  complaints.length = 0;
}

/** After everything has come in, the page has what the server has, although it was cut off for a while. */
async function whole(page, url) {
  const deadline = Date.now() + 240_000;
  let session;
  do {
    await new Promise((resolve) => setTimeout(resolve, 1000));
    session = await (await fetch(`${url}/v1/sessions/${page.url().split('/s/')[1].split('?')[0]}`)).json();
  } while ((session.has_writer || session.n_frames < FRAMES) && Date.now() < deadline);
  await becomes(page, 'Points', session.n_points);
  assert.equal(await number(page, 'Frames'), session.n_frames);
  assert.equal(await number(page, 'Keyframes'), session.n_keyframes);
  assert.equal(await number(page, 'Lines'), session.n_lines);
  assert.ok(session.n_points > 300, 'the demonstration made a map');
  passed(`nothing was lost by a broken connection: ${session.n_frames} frames, ${session.n_points} points`);
  return session;
}

async function byKeyboard(page) {
  await page.getByRole('slider', { name: 'Frame' }).focus();
  await page.keyboard.press('Home');
  await page.waitForURL(/frame=0/);
  for (let i = 0; i < 5; i += 1) await page.keyboard.press('ArrowRight');
  await page.waitForURL(/frame=5/);
  await page.getByRole('button', { name: 'Play' }).press('Enter');
  await page.waitForURL((address) => Number(/frame=(\d+)/.exec(address.hash)?.[1]) > 12);
  await page.getByRole('button', { name: 'Pause' }).press('Enter');
  passed('a session is played back');
  const canvas = page.getByRole('application');
  await canvas.focus();
  await page.keyboard.press('ArrowLeft');
  await page.keyboard.press('+');
  await page.waitForURL(/eye=/);
  await page.getByRole('button', { name: 'Next keyframe' }).press('Enter');
  await page.waitForURL(/keyframe=1\b/);
  await page.getByText(/Keyframe 1 is frame/).waitFor();
  passed('map and keyframes are reached by keyboard');
  const before = page.url();
  await page.reload();
  await page.getByText(/Keyframe 1 is frame/).waitFor();
  assert.equal(page.url(), before);
  assert.match((await page.locator('.frame-text').textContent()) ?? '', new RegExp(`Frame ${/frame=(\d+)/.exec(before)[1]},`));
  passed('an address brings a state back');
}

/** Picks two points by turning the map under the cross in its middle. */
async function scale(page, url, session) {
  await page.getByRole('button', { name: 'Newest' }).press('Enter');
  await page.getByRole('button', { name: 'Show all' }).press('Enter');
  await page.getByRole('button', { name: 'Pick two points' }).press('Enter');
  const canvas = page.getByRole('application');
  await canvas.focus();
  for (let turn = 0; turn < 40 && !(await page.getByLabel('They are').isVisible()); turn += 1) {
    await page.keyboard.press(turn % 3 === 0 ? 'ArrowUp' : 'Shift+ArrowRight');
    await page.keyboard.press('Enter');
    await page.waitForTimeout(120);
  }
  await page.getByLabel('They are').fill('2.5');
  await page.keyboard.press('Enter');
  await page.getByText('m a unit').waitFor();
  const told = await (await fetch(`${url}/v1/sessions/${session.id}`)).json();
  assert.ok(told.metres_per_unit > 0);
  await page.getByText(/map units apart, 2\.5 m/).waitFor();
  await page.getByRole('button', { name: 'Free the scale' }).press('Enter');
  await page.getByText('free (map units)').waitFor();
  passed('two points set the scale, and it is freed again');
}

/** The whole map is adjusted, and the page tells how far that is and what came of it. */
async function optimize(page, url, session) {
  const panel = page.getByRole('region', { name: 'Whole map' });
  await panel.getByRole('button', { name: 'Optimize' }).press('Enter');
  await panel.getByText(/cost/i).waitFor({ timeout: 120_000 });
  const { operations } = await (await fetch(`${url}/v1/operations?session=${session.id}`)).json();
  assert.deepEqual(operations.map(({ kind, state }) => [kind, state]), [['optimize', 'done']]);
  assert.equal(await panel.getByRole('status').textContent(), operations[0].message);
  assert.ok(await panel.getByRole('progressbar').isHidden());
  passed('a map is adjusted from the page');
}

async function layersAndExports(page, url) {
  for (const name of ['Covisibility', 'Primitive ties']) await page.getByLabel(name).check();
  await page.waitForURL(/show=.*covisibility\.primitives/);
  await page.getByText('keyframes that share landmarks').waitFor();
  const links = await page.locator('.links a').evaluateAll((all) => all.map((link) => link.getAttribute('href')));
  assert.equal(links.length, 10);
  for (const link of links) assert.equal((await fetch(url + link)).status, 200, link);
  passed('layers are turned on, every export is there');
}

async function finished(browser, page, url, session) {
  await check(page, 'session, dark');
  await byKeyboard(page);
  await scale(page, url, session);
  await optimize(page, url, session);
  await layersAndExports(page, url);
  await page.getByRole('button', { name: 'Next keyframe' }).press('Enter');
  await page.waitForTimeout(1500);
  await picture(page, 'finished');
  const light = await newPage(browser, { colorScheme: 'light' });
  await light.goto(page.url());
  await light.getByText(/Keyframe \d+ is frame/).waitFor();
  await check(light, 'session, light');
  const phone = await newPage(browser, { viewport: { width: 360, height: 740 }, colorScheme: 'light', hasTouch: true, isMobile: true });
  await phone.goto(`${url}/#/`);
  await phone.locator('.cards img').waitFor();
  await check(phone, 'list, 360 pixels');
  await phone.locator('.cards a').tap();
  await phone.waitForFunction(() => document.querySelector('.waiting')?.hidden);
  await phone.waitForTimeout(1500);
  await check(phone, 'session, 360 pixels');
  await picture(phone, 'phone');
}

/** A report is a file: it shows the same without a server and without a network. */
async function report(browser, grpc, session) {
  const folder = mkdtempSync(join(tmpdir(), 'monoslam-report-'));
  try {
    const file = join(folder, 'report.html');
    execFileSync(join(PROGRAMS, 'monoslam'), ['report', session.id, '--server', grpc, '--pictures', '4', '-o', file]);
    for (const [what, options] of [
      ['report, light', { colorScheme: 'light' }],
      ['report, 360 pixels, dark', { colorScheme: 'dark', viewport: { width: 360, height: 740 }, hasTouch: true, isMobile: true }],
    ]) {
      const page = await newPage(browser, { ...options, offline: true });
      const asked = [];
      page.on('request', (request) => /^(file|data|blob):/.test(request.url()) || asked.push(request.url()));
      await page.goto(pathToFileURL(file).href);
      await page.waitForFunction(() => document.querySelector('.waiting')?.hidden);
      await becomes(page, 'Points', session.n_points);
      const pictures = () => [...document.querySelectorAll('figure img, .keyframes img')].map((image) => image.complete && image.naturalWidth > 0);
      await page.waitForFunction(`(${pictures})().every(Boolean)`);
      assert.ok((await page.evaluate(pictures)).length >= 8, 'plots and keyframes');
      await page.locator('.keyframes a').last().click();
      await page.getByText(/Keyframe \d+ is frame/).waitFor();
      await page.waitForFunction(() => [...document.querySelectorAll('h2')].some((title) => /^Keyframe \d+$/.test(title.textContent)));
      await page.getByText(/keypoints see a point/).waitFor();
      await check(page, what);
      if (what.includes('light')) {
        await page.evaluate(() => scrollTo(0, 0));
        await picture(page, 'report');
      }
      assert.deepEqual(asked, [], 'nothing is fetched');
      await page.context().close();
    }
    passed('a report works as a file, without a network');
  } finally {
    rmSync(folder, { recursive: true, force: true });
  }
}

const forgetComplaints = () => complaints.splice(0);

async function viewer() {
  const browser = await chromium.launch({ executablePath: browserPath, args: FLAGS });
  let demo = null;
  try {
    await emptyAndAway(browser);
    demo = await demonstration(FRAMES);
    const page = await newPage(browser, { colorScheme: 'dark' });
    await live(page, demo.url);
    const session = await whole(page, demo.url);
    await finished(browser, page, demo.url, session);
    await report(browser, demo.grpc, session);
  } finally {
    await browser.close();
    await demo?.remove();
  }
}

if (!process.argv.includes('--only-capture')) await viewer();
await access({ newPage, check, passed, forgetComplaints, flags: FLAGS, browserPath });
await capture({ newPage, check, picture, passed, forgetComplaints, flags: FLAGS, browserPath });
assert.deepEqual(complaints, [], 'the console');
passed('no errors in the console');
console.log(`\n${n_passed} passed, 0 failed`);
