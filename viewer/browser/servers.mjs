/** Real servers for the browser's tests: an empty one, and the demonstration with its stream. */

import { execFileSync, spawn } from 'node:child_process';
import { mkdtempSync, rmSync } from 'node:fs';
import { createServer } from 'node:net';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { fileURLToPath } from 'node:url';

/** Where the programs are. */
export const PROGRAMS = process.env.VIEWER_PROGRAMS ?? fileURLToPath(new URL('../../target/debug', import.meta.url));

function freePort() {
  return new Promise((resolve) => {
    const probe = createServer().listen(0, '127.0.0.1', () => {
      const { port } = probe.address();
      probe.close(() => resolve(port));
    });
  });
}

async function answers(url) {
  for (let attempt = 0; attempt < 100; attempt += 1) {
    const ready = await fetch(`${url}/readyz`).then((response) => response.ok, () => false);
    if (ready) return;
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
  throw new Error(`${url} did not become ready`);
}

function ended(child) {
  return new Promise((resolve) => (child.exitCode === null ? child.once('exit', resolve) : resolve()));
}

/** A server over the database of a folder; it can be stopped and started again at the same address. */
export async function serverOver(data) {
  const [grpc, http] = [`127.0.0.1:${await freePort()}`, `127.0.0.1:${await freePort()}`];
  const url = `http://${http}`;
  let child = null;
  const start = async () => {
    const options = ['--data-dir', data, '--grpc-addr', grpc, '--http-addr', http];
    child = spawn(join(PROGRAMS, 'monoslam-server'), options, { stdio: 'ignore' });
    await answers(url);
  };
  const stop = async () => {
    child.kill('SIGKILL');
    await ended(child);
  };
  const makeToken = (name) => {
    const options = ['token', 'create', name, '--data-dir', data];
    return execFileSync(join(PROGRAMS, 'monoslam-server'), options, { stdio: ['ignore', 'pipe', 'ignore'] }).toString().trim();
  };
  await start();
  return { url, start, stop, makeToken };
}

/** A server over an empty database. */
export async function emptyServer() {
  const data = mkdtempSync(join(tmpdir(), 'monoslam-viewer-'));
  const server = await serverOver(data);
  const remove = async () => {
    await server.stop();
    rmSync(data, { recursive: true, force: true });
  };
  return { ...server, remove };
}

/** The demonstration: a server that a synthetic room is being streamed through. */
export async function demonstration(frames) {
  const child = spawn(join(PROGRAMS, 'monoslam'), ['demo', '--keep', '--frames', String(frames)], {
    stdio: ['ignore', 'pipe', 'pipe'],
  });
  let text = '';
  const [grpc, url] = await new Promise((resolve, reject) => {
    const read = (bytes) => {
      text += bytes;
      const match = /gRPC at (http:\/\/[\d.:]+), HTTP at (http:\/\/[\d.:]+)/.exec(text);
      if (match) resolve(match.slice(1));
    };
    child.stdout.on('data', read);
    child.stderr.on('data', read);
    child.once('exit', () => reject(new Error(`the demonstration ended:\n${text}`)));
  });
  const remove = async () => {
    child.kill('SIGINT');
    const patience = setTimeout(() => child.kill('SIGKILL'), 5000);
    await ended(child);
    clearTimeout(patience);
  };
  return { grpc, url, pid: child.pid, remove };
}

/** A server that is shared with a phone; `link` is what its QR code says. */
export async function sharedServer() {
  const data = mkdtempSync(join(tmpdir(), 'monoslam-viewer-'));
  const [grpc, http] = [`127.0.0.1:${await freePort()}`, `127.0.0.1:${await freePort()}`];
  const options = ['--quick-share', '--data-dir', data, '--grpc-addr', grpc, '--http-addr', http];
  const child = spawn(join(PROGRAMS, 'monoslam-server'), options, { stdio: ['ignore', 'pipe', 'ignore'] });
  let text = '';
  const link = await new Promise((resolve, reject) => {
    child.stdout.on('data', (bytes) => {
      text += bytes;
      const match = /https:\/\/\S+#token=\S+/.exec(text);
      if (match) resolve(match[0]);
    });
    child.once('exit', () => reject(new Error(`the server ended:\n${text}`)));
  });
  const remove = async () => {
    child.kill('SIGKILL');
    await ended(child);
    rmSync(data, { recursive: true, force: true });
  };
  return { link, remove };
}
