/** While frames are sent: the camera's picture, and over it the state and what to do. */

import { formatAddress, openSession } from '../address';
import { announce, count, h } from '../dom';
import { ADVICE, correctedAngle, MEANING } from './advice';
import type { Camera } from './camera';
import { MotionSensors } from './motion';
import { FrameStream, type FrameAnswer } from './stream';

/** Keeps the screen on; without it the camera stops after half a minute. */
async function keepAwake(): Promise<WakeLockSentinel | null> {
  try {
    return (await navigator.wakeLock?.request('screen')) ?? null;
  } catch {
    return null;
  }
}

export class Recording {
  readonly element: HTMLElement;
  /** Frames with an answer, and those of them with a pose. */
  nAnswered = 0;
  nTracked = 0;
  /** The field of view that the session has found, degrees. */
  foundFovDeg: number | null = null;

  readonly #advice = h('p', { class: 'advice' }, 'Connecting…');
  readonly #meaning = h('p', { class: 'meaning' });
  readonly #figures = h('p', { class: 'figures-line' });
  readonly #lens = h('p', { class: 'meaning', hidden: true });
  readonly #stop = h('button', { type: 'button', class: 'go', onclick: () => this.#finish() }, 'Stop');
  readonly #size: [number, number];
  readonly #stream: FrameStream;
  readonly #awake = keepAwake();
  readonly #motion: MotionSensors;
  #nKeyframes = 0;
  #isConnected = false;

  constructor(
    id: string,
    private readonly camera: Camera,
    private readonly fovDeg: number,
    onEnd: (error: string | null) => void,
  ) {
    this.#size = camera.size;
    this.#motion = new MotionSensors(id);
    const map = h('a', { href: `/${formatAddress(openSession(id))}`, target: '_blank', rel: 'noopener' }, 'Map');
    const texts = h('div', { class: 'over' }, this.#advice, this.#meaning, this.#lens);
    const bar = h('div', { class: 'bar' }, this.#figures, map, this.#stop);
    this.element = h('section', { class: 'capture', 'data-state': 'connecting' }, camera.video, texts, bar);
    this.#stream = new FrameStream(id, {
      onConnected: (isConnected) => this.#connected(isConnected),
      onAnswer: (answer) => this.#answered(answer),
      onUnused: (reason) => this.#show(this.#figures, reason),
      onEnd: (error) => {
        this.#release();
        onEnd(error);
      },
    });
    camera.start(
      () => this.#stream.hasRoom,
      (shot, size) => {
        if (size[0] === this.#size[0] && size[1] === this.#size[1]) this.#stream.send(shot);
        else this.#tell('turned', 'Hold the device as at the start', 'The picture has turned or changed its size.');
      },
    );
  }

  #connected(isConnected: boolean): void {
    if (this.#isConnected === isConnected) return;
    this.#isConnected = isConnected;
    if (isConnected) this.#tell('initialising', ADVICE.initialising, MEANING.initialising);
    else this.#tell('connecting', 'The server does not answer', `Hold still: trying again. ${count(this.#stream.nHeld)} pictures are kept until it has them.`);
  }

  #answered(answer: FrameAnswer): void {
    this.nAnswered += 1;
    if (answer.state === 'tracked' || answer.state === 'weak') this.nTracked += 1;
    if (answer.is_key_frame) this.#nKeyframes += 1;
    const why = answer.reason ? ` (${answer.reason})` : '';
    this.#tell(answer.state, ADVICE[answer.state], MEANING[answer.state] + why);
    const seen = `${count(answer.n_inlier_points)} points, ${count(answer.n_inlier_lines)} lines seen`;
    this.#show(this.#figures, `${count(this.nAnswered)} pictures, ${count(this.#nKeyframes)} keyframes; ${seen}; ${Math.round(answer.wall_ms)} ms`);
    answer.corrections.forEach(({ camera }) => camera && this.#found(camera.focal, camera.adopted));
  }

  #found(focalChange: number, isAdopted: boolean): void {
    this.foundFovDeg = correctedAngle(this.fovDeg, focalChange);
    const angle = `${this.foundFovDeg.toFixed(1)}°`;
    this.#lens.hidden = false;
    this.#show(this.#lens, isAdopted ? `Field of view found: ${angle}.` : `The pictures say that the field of view is about ${angle}, not ${this.fovDeg}°: too far off for this map. Start again with it.`);
  }

  /** Says the state, aloud only when it changes. */
  #tell(state: string, advice: string, meaning: string): void {
    if (this.element.dataset.state !== state) announce(advice);
    this.element.dataset.state = state;
    this.#show(this.#advice, advice);
    this.#show(this.#meaning, meaning);
  }

  #show(element: HTMLElement, text: string): void {
    if (element.textContent !== text) element.textContent = text;
  }

  #finish(): void {
    this.#stop.disabled = true;
    this.#tell('saving', 'Saving the map…', 'The last pictures are tracked.');
    this.#release();
    this.#stream.finish();
  }

  #release(): void {
    this.camera.stop();
    this.#motion.stop();
    void this.#awake.then((lock) => lock?.release());
  }
}
