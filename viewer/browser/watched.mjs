/**
 * What watching costs a server: `npm run watched`, with the programs built and a chromium. The demonstration's stream is
 * tracked without a browser and with ten that follow it; told are the processor time of the server's process, which
 * renders the room and sends the images as well, and what each browser received.
 */

import { readFileSync } from 'node:fs';
import { chromium } from 'playwright-core';
import { browserPath, FLAGS } from './chromium.mjs';
import { demonstration } from './servers.mjs';

const N_BROWSERS = 10;
const N_FRAMES = 150;

/** Seconds of processor time of a process so far: user and system. */
function cpuS(pid) {
  const fields = readFileSync(`/proc/${pid}/stat`, 'utf8').split(') ')[1].split(' ');
  return (Number(fields[11]) + Number(fields[12])) / 100;
}

async function watch(browser, url, received) {
  const page = await (await browser.newContext({ viewport: { width: 800, height: 600 } })).newPage();
  const client = await page.context().newCDPSession(page);
  await client.send('Network.enable');
  client.on('Network.dataReceived', ({ encodedDataLength, dataLength }) => {
    received.bytes += encodedDataLength || dataLength;
  });
  await page.goto(url);
  await page.locator('.cards a').click({ timeout: 120_000 });
}

async function run(nBrowsers) {
  const browser = nBrowsers > 0 ? await chromium.launch({ executablePath: browserPath, args: FLAGS }) : null;
  const demo = await demonstration(N_FRAMES);
  const received = { bytes: 0 };
  try {
    await Promise.all(Array.from({ length: nBrowsers }, () => watch(browser, demo.url, received)));
    let session;
    do {
      await new Promise((resolve) => setTimeout(resolve, 250));
      [session] = (await (await fetch(`${demo.url}/v1/sessions`)).json()).sessions;
    } while (!session || session.has_writer || session.n_frames < N_FRAMES);
    return { cpuS: cpuS(demo.pid), bytes: received.bytes };
  } finally {
    await browser?.close();
    await demo.remove();
  }
}

const alone = await run(0);
const watched = await run(N_BROWSERS);
const perFrame = (seconds) => ((1000 * seconds) / N_FRAMES).toFixed(1);
console.log(`| browsers | ms of processor a frame | kB to each browser | kB a frame |\n| ---: | ---: | ---: | ---: |
| 0 | ${perFrame(alone.cpuS)} | - | - |
| ${N_BROWSERS} | ${perFrame(watched.cpuS)} | ${(watched.bytes / N_BROWSERS / 1000).toFixed(0)} | ${(watched.bytes / N_BROWSERS / 1000 / N_FRAMES).toFixed(1)} |`);
