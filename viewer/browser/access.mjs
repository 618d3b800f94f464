/** The pages of a server that needs a token. */

import assert from 'node:assert/strict';
import { chromium } from 'playwright-core';
import { emptyServer } from './servers.mjs';

const CAMERA = { model: 'pinhole', width: 640, height: 480, fx: 460, fy: 460, cx: 319.5, cy: 239.5 };

async function asked(browser, { newPage, check, passed }, server, token) {
  const page = await newPage(browser, {});
  await page.goto(`${server.url}/`);
  await page.getByRole('heading', { name: 'This server needs a token' }).waitFor();
  await check(page, 'the question for a token');
  await page.getByRole('textbox', { name: 'Token' }).fill('monoslam_wrong');
  await page.keyboard.press('Enter');
  await page.getByText('does not take the token').waitFor();
  await page.getByRole('textbox', { name: 'Token' }).fill(token);
  await page.keyboard.press('Enter');
  await page.getByText('One session.').waitFor();
  passed('a token is asked for, refused when it is wrong, and lets in when it is right');
  const events = page.waitForResponse((response) => response.url().endsWith('/events'));
  await page.getByRole('link', { name: /hall/ }).click();
  assert.equal((await events).status(), 200, 'the events come with the ticket');
  const cookies = await page.context().cookies();
  assert.ok(cookies.length === 1 && cookies[0].httpOnly && cookies[0].sameSite === 'Strict', JSON.stringify(cookies));
  await page.reload();
  await page.waitForFunction(() => document.title.startsWith('hall'));
  assert.equal(await page.getByRole('heading', { name: 'This server needs a token' }).count(), 0, 'it is kept');
  passed('events come with a ticket, and the token is kept');
  await page.context().close();
}

async function brought(browser, { newPage, passed }, server, token) {
  const page = await newPage(browser, {});
  await page.goto(`${server.url}/capture#token=${token}`);
  await page.getByRole('heading', { name: 'This device’s camera' }).waitFor();
  assert.equal(page.url(), `${server.url}/capture`, 'the token is not left in the address');
  await page.goto(`${server.url}/`);
  await page.getByText('One session.').waitFor();
  passed('a link brings its token, which the address does not show');
  await page.context().close();
}

/** Runs with the tools of `run.mjs`. */
export async function access(tools) {
  const browser = await chromium.launch({ executablePath: tools.browserPath, args: tools.flags });
  const server = await emptyServer();
  try {
    const token = server.makeToken('robot');
    // A new token is noticed within a second.
    await new Promise((resolve) => setTimeout(resolve, 1500));
    const made = await fetch(`${server.url}/v1/sessions`, {
      method: 'POST',
      headers: { 'content-type': 'application/json', authorization: `Bearer ${token}` },
      body: JSON.stringify({ id: 'hall', camera: CAMERA }),
    });
    assert.equal(made.status, 201);
    await asked(browser, tools, server, token);
    await brought(browser, tools, server, token);
    tools.forgetComplaints(); // The browser itself complains about answers with 401.
  } finally {
    await browser.close();
    await server.remove();
  }
}
