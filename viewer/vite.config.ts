import { createHash } from 'node:crypto';
import { copyFileSync, readFileSync, readdirSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { defineConfig, type Plugin } from 'vite';

/** What the page is built from; the repository's tests hash the same files in the same order. */
const SOURCES = ['capture.html', 'index.html', 'package-lock.json', 'package.json', 'public', 'src', 'vite.config.ts'];

function files(path: string): string[] {
  try {
    const entries = readdirSync(path).sort();
    return entries.flatMap((entry) => files(join(path, entry)));
  } catch {
    return [path];
  }
}

/** Adds the license of three.js, which the page carries, and leaves a hash of the sources beside what was built, so that a test notices when the two differ. */
function sourcesHash(): Plugin {
  return {
    name: 'sources-hash',
    apply: 'build',
    closeBundle() {
      const hash = createHash('sha256');
      for (const path of SOURCES.flatMap(files)) {
        hash.update(path).update('\0').update(readFileSync(path)).update('\0');
      }
      copyFileSync('node_modules/three/LICENSE', 'dist/assets/three-LICENSE.txt');
      writeFileSync('dist/sources.sha256', `${hash.digest('hex')}\n`);
    },
  };
}

/** The server that `npm run dev` takes sessions from. */
const proxy = { '/v1': { target: process.env['VIEWER_HTTP'] ?? 'http://127.0.0.1:8080', ws: true } };

/** Each page is built by itself and shares no file with the other: a report carries the viewer as one script. */
export default defineConfig(({ mode }) => ({
  base: '/',
  build: {
    emptyOutDir: mode !== 'capture',
    target: 'es2022',
    modulePreload: { polyfill: false },
    // Nothing inside the page's text: its content security policy forbids that.
    assetsInlineLimit: 0,
    chunkSizeWarningLimit: 1000,
    rolldownOptions: { input: mode === 'capture' ? 'capture.html' : 'index.html' },
  },
  server: { proxy },
  preview: { proxy },
  plugins: [sourcesHash()],
}));
