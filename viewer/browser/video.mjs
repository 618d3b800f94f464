/** A recording as a video that chromium's fake camera plays: there and back, so that it has no jumps. */

import { execFileSync } from 'node:child_process';
import { existsSync, mkdtempSync, readFileSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import { join } from 'node:path';
import { PROGRAMS } from './servers.mjs';

/** Of the recordings that tests may have, one whose images may be shown in the documents (ICL-NUIM, CC BY 3.0). */
const RECORDING = 'icl_of_kt0_first101';

/** Pictures a second: few, as the machine also plays the camera and draws the page. Chromium takes it from the file. */
const FPS = 10;

function rendered(folder) {
  const program = join(PROGRAMS, 'examples/render');
  if (!existsSync(program)) return null;
  const options = ['--preset', 'room-rich', '--seed', '1', '--frames', '60', '--out', folder];
  execFileSync(program, options, { stdio: 'ignore' });
  return folder;
}

/** The video's file and its horizontal field of view in degrees; `null` with what is missing. */
export function fakeCamera() {
  try {
    execFileSync('ffmpeg', ['-version'], { stdio: 'ignore' });
  } catch {
    return { missing: 'ffmpeg' };
  }
  const folder = mkdtempSync(join(tmpdir(), 'monoslam-camera-'));
  const known = process.env.MONOSLAM_DATA && join(process.env.MONOSLAM_DATA, RECORDING);
  const recording = known && existsSync(known) ? known : rendered(join(folder, 'room'));
  if (!recording) return { missing: 'the example `render` (cargo build --workspace --all-targets)' };
  const rows = readFileSync(join(recording, 'rgb.txt'), 'utf8').split('\n').filter((row) => row && !row.startsWith('#'));
  const files = rows.map((row) => join(recording, row.split(' ')[1]));
  const both = [...files, ...files.slice(1, -1).reverse()];
  writeFileSync(join(folder, 'list.txt'), both.map((file) => `file '${file}'\nduration ${1 / FPS}\n`).join(''));
  const video = join(folder, 'camera.y4m');
  const input = ['-f', 'concat', '-safe', '0', '-i', join(folder, 'list.txt')];
  execFileSync('ffmpeg', ['-v', 'error', '-y', ...input, '-r', String(FPS), '-pix_fmt', 'yuv420p', video]);
  const { width, fx } = JSON.parse(readFileSync(join(recording, 'calib.json'), 'utf8'));
  return { folder, video, fovDeg: (Math.atan(width / 2 / fx) * 360) / Math.PI };
}
