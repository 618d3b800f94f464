/** The page at /capture with chromium's fake camera, which plays a recording: its frames become a map. */

import assert from 'node:assert/strict';
import { rmSync } from 'node:fs';
import { chromium } from 'playwright-core';
import { emptyServer, sharedServer } from './servers.mjs';
import { fakeCamera } from './video.mjs';

/** A name that is not this machine's own, so that the page is not secure. */
const ELSEWHERE = 'elsewhere';

const state = (page, wanted) => page.waitForSelector(`.capture[data-state="${wanted}"]`, { timeout: 60_000 });
const pictures = async (page) => Number(/(\d+) pictures/.exec((await page.locator('.figures-line').textContent()) ?? '')?.[1] ?? 0);

/** In the page: keeps every advice that is given, as some stands for a moment only. */
function watchAdvice() {
  globalThis.adviceTold = [];
  new MutationObserver(() => {
    const advice = document.querySelector('.advice')?.textContent;
    if (advice && advice !== globalThis.adviceTold.at(-1)) globalThis.adviceTold.push(advice);
  }).observe(document.body, { subtree: true, childList: true, characterData: true });
}

async function insecure(browser, { newPage, passed }, server) {
  const page = await newPage(browser, {});
  await page.goto(`http://${ELSEWHERE}:${new URL(server.url).port}/capture`);
  await page.getByText('only over HTTPS').waitFor();
  assert.ok(await page.getByRole('button', { name: 'Start the camera' }).isDisabled());
  await page.context().close();
  passed('a page that is not secure says that it gets no camera, and what to do');
}

/** Gives the page motion sensors that tell something new a hundred times a second. */
async function shaken(page) {
  const client = await page.context().newCDPSession(page);
  const types = ['gyroscope', 'accelerometer'];
  for (const type of types) {
    await client.send('Emulation.setSensorOverrideEnabled', { enabled: true, type, metadata: { available: true } });
  }
  let n = 0;
  const timer = setInterval(() => {
    n += 1;
    const readings = [{ x: 0.25, y: -0.5, z: n / 1000 }, { x: n / 1000, y: -9.5, z: 1.5 }];
    types.forEach((type, i) => client.send('Emulation.setSensorOverrideReadings', { type, reading: { xyz: readings[i] } }).catch(() => {}));
  }, 10);
  return () => clearInterval(timer);
}

/** What the sensors said is kept, each reading once. */
async function checkMotion(server, passed) {
  const [head, ...lines] = (await (await fetch(`${server.url}/v1/sessions/phone/motion`)).text()).trim().split('\n');
  assert.match(head, /^#timestamp/);
  assert.ok(lines.length > 60, `${lines.length} readings`);
  const readings = lines.map((line) => line.split(','));
  // Browsers round what sensors say.
  const near = (value, wanted) => Math.abs(Number(value) - wanted) < 0.01;
  for (const reading of readings) {
    const [, p, q, , , y, z] = reading;
    assert.ok(near(p, 0.25) && near(q, -0.5) && near(y, -9.5) && near(z, 1.5), reading.join());
  }
  readings.slice(1).forEach(([ns], i) => assert.ok(BigInt(ns) > BigInt(readings[i][0]), 'each once, in order'));
  passed(`the motion sensors' readings are kept: ${lines.length}`);
}

async function mapped(browser, { newPage, check, picture, passed, forgetComplaints }, server, fovDeg) {
  const page = await newPage(browser, { viewport: { width: 390, height: 780 }, permissions: ['camera', 'accelerometer', 'gyroscope'], colorScheme: 'light' });
  const calm = await shaken(page);
  await page.goto(`${server.url}/#/`);
  await page.getByRole('link', { name: 'Use this device’s camera' }).click();
  await page.getByLabel('Name of the session').fill('phone');
  await page.getByLabel('Field of view').fill(fovDeg.toFixed(2));
  await check(page, 'camera, before the start');
  await page.evaluate(watchAdvice);
  await page.getByLabel('Field of view').focus();
  await page.keyboard.press('Enter');
  await state(page, 'tracked');
  const told = await page.evaluate(() => globalThis.adviceTold);
  assert.deepEqual([told.includes('Move sideways'), told.at(-1)], [true, 'Good, walk on'], told.join(', '));
  await check(page, 'camera, tracked');
  passed('the camera is tracked, and its holder told what to do');
  await page.waitForFunction(() => Number(/(\d+) keyframes/.exec(document.querySelector('.figures-line').textContent)?.[1]) > 5, null, { timeout: 120_000 });
  await picture(page, 'capture');

  await server.stop();
  await state(page, 'connecting');
  const before = await pictures(page);
  await server.start();
  await state(page, 'tracked');
  await page.waitForFunction((n) => Number(/(\d+) pictures/.exec(document.querySelector('.figures-line').textContent)?.[1]) > n + 10, before, { timeout: 120_000 });
  forgetComplaints(); // The browser itself complains about a server that is away.
  passed('a server that is killed is found again');

  await page.getByRole('button', { name: 'Stop' }).click();
  await page.getByText('Done').waitFor({ timeout: 60_000 });
  const said = Number(/(\d+) pictures/.exec(await page.locator('main').textContent())[1]);
  const session = await (await fetch(`${server.url}/v1/sessions/phone`)).json();
  assert.ok(session.n_keyframes > 5 && session.n_points > 300, JSON.stringify(session));
  assert.equal(session.durable_sequence, session.next_sequence - 1, 'everything is saved');
  assert.ok(said > before);
  assert.equal(session.n_frames, said, 'each picture is in the session once, although the server was killed');
  assert.equal(session.has_writer, false);
  calm();
  await checkMotion(server, passed);
  await page.getByRole('link', { name: 'See the map' }).click();
  await page.waitForFunction(() => document.querySelector('.waiting')?.hidden);
  passed(`the camera's frames became a map: ${session.n_frames} frames, ${session.n_keyframes} keyframes, ${session.n_points} points`);
  await page.context().close();
}

/** What a phone does with the address of `--quick-share`. */
async function shared(browser, { newPage, passed }, fovDeg) {
  const server = await sharedServer();
  try {
    const page = await newPage(browser, { viewport: { width: 390, height: 780 }, permissions: ['camera'], ignoreHTTPSErrors: true });
    await page.goto(server.link);
    assert.ok(!page.url().includes('token'), page.url());
    await page.getByLabel('Field of view').fill(fovDeg.toFixed(2));
    await page.getByRole('button', { name: 'Start the camera' }).click();
    await state(page, 'tracked');
    await page.getByRole('button', { name: 'Stop' }).click();
    await page.getByText('Done').waitFor({ timeout: 60_000 });
    await page.getByRole('link', { name: 'See the map' }).click();
    await page.waitForFunction(() => document.querySelector('.waiting')?.hidden);
    passed('a phone maps by the address of --quick-share: encrypted, with its token, and sees the map');
    await page.context().close();
  } finally {
    await server.remove();
  }
}

/** Runs with the tools of `run.mjs`. */
export async function capture(tools) {
  const camera = fakeCamera();
  if (camera.missing) {
    console.log(`skipped - the camera page: there is no ${camera.missing}`);
    return;
  }
  const fake = ['--use-fake-ui-for-media-stream', '--use-fake-device-for-media-stream', `--use-file-for-fake-video-capture=${camera.video}`];
  const args = [...tools.flags, ...fake, `--host-resolver-rules=MAP ${ELSEWHERE} 127.0.0.1`];
  const browser = await chromium.launch({ executablePath: tools.browserPath, args });
  const server = await emptyServer();
  try {
    await insecure(browser, tools, server);
    await mapped(browser, tools, server, camera.fovDeg);
    await shared(browser, tools, camera.fovDeg);
  } finally {
    await browser.close();
    await server.remove();
    rmSync(camera.folder, { recursive: true, force: true });
  }
}
