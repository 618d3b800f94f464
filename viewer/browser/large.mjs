/**
 * How the page copes with large maps: `npm run large [-- --pictures DIR]`, with the programs built, a chromium and
 * sqlite3. Prints for 100,000 and 1,000,000 points how long the map takes to be there and what a
 * picture costs while the map is turned.
 */

import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { mkdirSync, mkdtempSync, readdirSync, readlinkSync, rmSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { chromium } from 'playwright-core';
import { browserPath, FLAGS } from './chromium.mjs';
import { demonstration, serverOver } from './servers.mjs';

const pictures = process.argv.includes('--pictures') ? process.argv[process.argv.indexOf('--pictures') + 1] : null;
const TURNING_MS = 5000;

/** Points as they are on the walls, floor and ceiling of a hall of 40 by 20 by 6 units. */
function fill(database, n) {
  const unit = '((abs(random()) % 1000003) / 1000003.0)';
  const [x, y, z] = [`(40 * ${unit} - 20)`, `(6 * ${unit} - 3)`, `(20 * ${unit} - 5)`];
  const wall = `CASE n % 4 WHEN 0 THEN`;
  execFileSync('sqlite3', [database], {
    input: `PRAGMA synchronous = OFF;
      WITH RECURSIVE n(n) AS (SELECT 0 UNION ALL SELECT n + 1 FROM n WHERE n < ${n - 1}),
           one AS (SELECT * FROM points LIMIT 1)
      INSERT INTO points
      SELECT session, 1000000 + n, submap, ${wall} -20 WHEN 1 THEN 20 ELSE ${x} END,
             ${wall} ${y} WHEN 1 THEN ${y} WHEN 2 THEN -3 ELSE 3 END, ${z},
             descriptor, view_x, view_y, view_z, 1, 8, created_by, n_visible, n_found, n_observations, observations
      FROM n, one;
      UPDATE sessions SET n_points = (SELECT count(*) FROM points), last_point_id = (SELECT max(id) FROM points);`,
  });
}

/** The database of the demonstration, once its stream is over. */
async function demonstrated(into) {
  const demo = await demonstration(60);
  try {
    let session;
    do {
      await new Promise((resolve) => setTimeout(resolve, 500));
      [session] = (await (await fetch(`${demo.url}/v1/sessions`)).json()).sessions;
    } while (!session || session.has_writer || session.n_frames < 60);
    const files = readdirSync(`/proc/${demo.pid}/fd`).map((fd) => {
      try {
        return readlinkSync(`/proc/${demo.pid}/fd/${fd}`);
      } catch {
        return '';
      }
    });
    const database = files.find((file) => file.endsWith('/monoslam.sqlite'));
    assert.ok(database, 'the demonstration has a database');
    execFileSync('sqlite3', [database, `.backup '${into}'`]);
    return [database.split('/').pop(), session.id];
  } finally {
    await demo.remove();
  }
}

async function turned(page) {
  const client = await page.context().newCDPSession(page);
  await client.send('Performance.enable');
  const metrics = async () => Object.fromEntries((await client.send('Performance.getMetrics')).metrics.map(({ name, value }) => [name, value]));
  await page.getByRole('application').focus();
  const before = await metrics();
  const counting = page.evaluate((ms) => new Promise((resolve) => {
    const begin = performance.now();
    let n = 0;
    const step = () => {
      n += 1;
      document.querySelector('canvas').dispatchEvent(new KeyboardEvent('keydown', { key: 'ArrowLeft', bubbles: true }));
      if (performance.now() - begin < ms) requestAnimationFrame(step);
      else resolve([n, performance.now() - begin]);
    };
    requestAnimationFrame(step);
  }), TURNING_MS);
  const [n, ms] = await counting;
  const after = await metrics();
  return { perSecond: (1000 * n) / ms, scriptMs: (1000 * (after.ScriptDuration - before.ScriptDuration)) / n };
}

async function measure(folder, file, id, n) {
  const server = await serverOver(folder);
  const browser = await chromium.launch({ executablePath: browserPath, args: FLAGS });
  try {
    const page = await (await browser.newContext({ viewport: { width: 1280, height: 800 }, colorScheme: 'dark' })).newPage();
    const faults = [];
    page.on('console', (message) => message.type() === 'error' && faults.push(message.text()));
    page.on('pageerror', (error) => faults.push(error.message));
    const begin = Date.now();
    await page.goto(`${server.url}/#/s/${id}`);
    const told = String((await (await fetch(`${server.url}/v1/sessions/${id}`)).json()).n_points);
    await page.waitForFunction((told) => {
      const term = [...document.querySelectorAll('dt')].find((term) => term.textContent === 'Points');
      return term?.nextElementSibling.textContent.replace(/\D/g, '') === told && document.querySelector('.waiting')?.hidden;
    }, told, { timeout: 300_000 });
    const loadedS = (Date.now() - begin) / 1000;
    await page.getByRole('button', { name: 'Show all' }).press('Enter');
    const { perSecond, scriptMs } = await turned(page);
    if (pictures) await page.screenshot({ path: join(pictures, `viewer-${n}-points.png`) });
    assert.deepEqual(faults, [], 'the console');
    console.log(`| ${n} | ${loadedS.toFixed(1)} | ${perSecond.toFixed(1)} | ${scriptMs.toFixed(1)} |`);
  } finally {
    await browser.close();
    await server.stop();
  }
}

const folder = mkdtempSync(join(tmpdir(), 'monoslam-large-'));
try {
  const original = join(folder, 'original.db');
  const [file, id] = await demonstrated(original);
  console.log('| points | s until all are there | pictures a second | ms of scripts for one |\n| ---: | ---: | ---: | ---: |');
  for (const n of [100_000, 1_000_000]) {
    const data = join(folder, String(n));
    mkdirSync(data);
    execFileSync('cp', [original, join(data, file)]);
    fill(join(data, file), n);
    await measure(data, file, id, n);
  }
} finally {
  rmSync(folder, { recursive: true, force: true });
}
