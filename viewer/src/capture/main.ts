/** The page at /capture: a phone or a webcam as the camera of a session. */

import '../style.css';
import './capture.css';
import { formatAddress, openSession } from '../address';
import { admit, takeTokenFromAddress } from '../data/access';
import { request } from '../data/api';
import { h } from '../dom';
import { setUpTheme } from '../theme';
import { assumedCamera, DEFAULT_FOV_DEG, FOV_RANGE_DEG } from './advice';
import { Camera, cameraProblem } from './camera';
import { allowMotion } from './motion';
import { Recording } from './recording';

const FOV_KEY = 'monoslam-fov-deg';

const main = document.getElementById('main')!;

function rememberedFov(): number {
  try {
    const value = Number(localStorage.getItem(FOV_KEY));
    return value >= FOV_RANGE_DEG[0] && value <= FOV_RANGE_DEG[1] ? value : DEFAULT_FOV_DEG;
  } catch {
    return DEFAULT_FOV_DEG;
  }
}

function rememberFov(fovDeg: number): void {
  try {
    localStorage.setItem(FOV_KEY, String(Math.round(fovDeg * 10) / 10));
  } catch {
    // Without storage it is asked for again.
  }
}

/** Why this page cannot have a camera here; `null` if it can. */
function obstacle(): string | null {
  if (!isSecureContext) {
    return `Browsers give a page the camera only over HTTPS or on this very machine. This page came from ${location.origin}. Open it by https://, or on the server itself by http://localhost:${location.port || '80'}/capture.`;
  }
  if (!navigator.mediaDevices?.getUserMedia) return 'This browser gives pages no camera.';
  if (!('requestVideoFrameCallback' in HTMLVideoElement.prototype)) return 'This browser does not tell when a picture was taken; a newer one does.';
  return null;
}

function showStart(problem: string | null): void {
  const name = h('input', { type: 'text', id: 'name', maxlength: 64, pattern: '[A-Za-z0-9_\\-]*', autocomplete: 'off', placeholder: 'made up if left empty' });
  const fov = h('input', { type: 'number', id: 'fov', min: FOV_RANGE_DEG[0], max: FOV_RANGE_DEG[1], step: 'any', required: true, value: rememberedFov() });
  const start = h('button', { type: 'submit', class: 'go' }, 'Start the camera');
  const text = h('p', { class: 'problem', role: 'alert' });
  const found = obstacle();
  text.textContent = found ?? problem ?? '';
  text.hidden = text.textContent === '';
  start.disabled = found !== null;
  const form = h(
    'form',
    {
      class: 'start',
      onsubmit: (event) => {
        event.preventDefault();
        start.disabled = true;
        void begin(name.value.trim(), fov.valueAsNumber);
      },
    },
    h('h1', {}, 'This device’s camera'),
    text,
    h('p', {}, 'Its pictures go to this server, which makes a map of what they show. Walk, and move sideways at first: turning on the spot shows no depth.'),
    h('label', { for: 'name' }, 'Name of the session'),
    name,
    h('label', { for: 'fov' }, 'Field of view along the longer side, degrees'),
    fov,
    h('p', { class: 'note' }, `Browsers do not tell how wide a camera sees, so the server begins with this angle. ${DEFAULT_FOV_DEG}° is near most phones’ main camera and webcams. Errors of a few percent are put right as the map grows, and what was found is kept here for the next time; with larger ones the map is bent. Do not zoom, and do not change the lens.`),
    start,
  );
  main.replaceChildren(form);
}

async function begin(name: string, fovDeg: number): Promise<void> {
  rememberFov(fovDeg);
  let camera: Camera | null = null;
  try {
    await allowMotion();
    camera = await Camera.open();
    const id = await createSession(name, ...camera.size, fovDeg);
    history.replaceState(null, '', `/capture#${encodeURIComponent(id)}`);
    const recording = new Recording(id, camera, fovDeg, (error) => showEnd(id, recording, error));
    main.replaceChildren(recording.element);
  } catch (error) {
    camera?.stop();
    showStart(cameraProblem(error));
  }
}

async function createSession(name: string, width: number, height: number, fovDeg: number): Promise<string> {
  const response = await request('/v1/sessions', {
    method: 'POST',
    headers: { 'content-type': 'application/json' },
    body: JSON.stringify({
      ...(name ? { id: name } : {}),
      camera: assumedCamera(width, height, fovDeg),
      // The angle is a guess: the session finds focal length and distortion as the map grows.
      options: { calibration: 'approximate' },
    }),
  });
  return ((await response.json()) as { id: string }).id;
}

function showEnd(id: string, recording: Recording, error: string | null): void {
  if (recording.foundFovDeg !== null) rememberFov(recording.foundFovDeg);
  const text = error ?? `${recording.nAnswered} pictures are in the map’s session, ${recording.nTracked} of them with a pose when they came.`;
  main.replaceChildren(
    h(
      'section',
      { class: 'start' },
      h('h1', {}, error ? 'The stream has ended' : 'Done'),
      h('p', error ? { class: 'problem', role: 'alert' } : { role: 'status' }, text),
      h('p', {}, h('a', { class: 'go', href: `/${formatAddress(openSession(id))}` }, 'See the map')),
      h('p', {}, h('button', { type: 'button', onclick: () => showStart(null) }, 'Another one')),
    ),
  );
}

setUpTheme(document.getElementById('theme') as HTMLButtonElement);
takeTokenFromAddress();
void admit().then(() => showStart(null));
