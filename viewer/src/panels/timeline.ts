/** The timeline: the states of all frames, a slider through them, and playing a session back. */

import { stateColor } from '../colors';
import type { State } from '../data/api';
import type { FrameRow, Scene } from '../data/scene';
import { count, h } from '../dom';
import { theme } from '../theme';

export interface Span {
  state: State;
  /** First and last frame, by their places in the order of frames. */
  from: number;
  to: number;
}

/** Runs of frames of one state. */
export function spans(frames: FrameRow[]): Span[] {
  const found: Span[] = [];
  frames.forEach(({ state }, i) => {
    const last = found.at(-1);
    if (last?.state === state) last.to = i;
    else found.push({ state, from: i, to: i });
  });
  return found;
}

/** How a frame is told in words. */
export function frameText(frame: FrameRow): string {
  const placed = frame.pose ? (frame.backfilled ? ', placed afterwards' : '') : ', no pose';
  const reason = frame.reason ? `: ${frame.reason}` : '';
  return `Frame ${frame.sequence}, ${frame.state}${placed}${reason}`;
}

const STATES: State[] = ['initialising', 'tracked', 'weak', 'lost'];
/** Shares of the strip's height by state, so that states differ by more than color. */
const HEIGHTS: Record<State, number> = { tracked: 1, weak: 0.7, initialising: 0.45, lost: 0.25 };
/** Longest pause between two frames that is played, ms. */
const LONGEST_PAUSE_MS = 250;

export class Timeline {
  readonly element: HTMLElement;
  readonly #strip = h('canvas', { 'aria-hidden': 'true' });
  readonly #slider = h('input', { type: 'range', min: 0, max: 0, value: 0, 'aria-label': 'Frame' });
  readonly #text = h('p', { class: 'note frame-text' });
  readonly #legend = h('ul', { class: 'states', 'aria-label': 'Frames by state' });
  readonly #play = h('button', { type: 'button', onclick: () => this.#togglePlay() }, 'Play');
  readonly #newest = h('button', { type: 'button', onclick: () => this.#choose(null) }, 'Newest');
  /** The chosen frame's number; `null` follows the newest. */
  #frame: number | null = null;
  #timer = 0;

  constructor(
    private readonly scene: Scene,
    private readonly onFrame: (frame: number | null) => void,
  ) {
    this.#slider.addEventListener('input', () => {
      const i = Number(this.#slider.value);
      this.#stop();
      this.#choose(i >= this.scene.frameOrder().length - 1 ? null : (this.scene.frameOrder()[i]?.sequence ?? null));
    });
    const controls = h('div', { class: 'row' }, this.#play, this.#newest, this.#legend);
    const strip = h('div', { class: 'strip' }, this.#strip, this.#slider);
    this.element = h('section', { class: 'timeline', 'aria-label': 'Timeline' }, strip, this.#text, controls);
    new ResizeObserver(() => this.#drawStrip()).observe(this.#strip);
  }

  /** Shows the frames there are and which one is chosen. */
  update(frame: number | null): void {
    this.#frame = frame;
    const frames = this.scene.frameOrder();
    this.#slider.max = String(Math.max(0, frames.length - 1));
    this.#slider.value = String(this.#index(frames));
    this.#slider.disabled = this.#play.disabled = frames.length === 0;
    this.#newest.setAttribute('aria-pressed', String(frame === null));
    const shown = frames[this.#index(frames)];
    const text = shown ? frameText(shown) : 'No frame has come in yet.';
    this.#text.textContent = text;
    this.#slider.setAttribute('aria-valuetext', text);
    this.#legend.replaceChildren(...STATES.map((state) => this.#entry(state, frames)));
    this.#drawStrip();
  }

  close(): void {
    this.#stop();
  }

  #entry(state: State, frames: FrameRow[]): HTMLElement {
    const swatch = h('span', { class: `swatch state-${state}`, 'aria-hidden': 'true' });
    const n = frames.filter((frame) => frame.state === state).length;
    return h('li', {}, swatch, `${state} ${count(n)}`);
  }

  #index(frames: FrameRow[]): number {
    if (this.#frame === null) return frames.length - 1;
    let low = 0;
    let high = frames.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (frames[middle]!.sequence <= this.#frame) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  #choose(frame: number | null): void {
    if (frame === null) this.#stop();
    this.onFrame(frame);
  }

  #togglePlay(): void {
    if (this.#timer) {
      this.#stop();
      return;
    }
    const frames = this.scene.frameOrder();
    if (this.#index(frames) >= frames.length - 1) this.onFrame(frames[0]?.sequence ?? null);
    this.#play.textContent = 'Pause';
    this.#step();
  }

  #step(): void {
    const frames = this.scene.frameOrder();
    const i = this.#index(frames);
    const [here, next] = [frames[i], frames[i + 1]];
    if (!here || !next) {
      this.#choose(null);
      return;
    }
    const pause = Math.min(LONGEST_PAUSE_MS, Math.max(15, 1000 * (next.timeS - here.timeS)));
    this.#timer = window.setTimeout(() => {
      this.onFrame(next.sequence);
      if (this.#timer) this.#step();
    }, pause);
  }

  #stop(): void {
    clearTimeout(this.#timer);
    this.#timer = 0;
    this.#play.textContent = 'Play';
  }

  #drawStrip(): void {
    const { clientWidth: width, clientHeight: height } = this.#strip;
    if (width === 0) return;
    const ratio = devicePixelRatio;
    this.#strip.width = width * ratio;
    this.#strip.height = height * ratio;
    const context = this.#strip.getContext('2d')!;
    context.scale(ratio, ratio);
    const frames = this.scene.frameOrder();
    const unit = width / Math.max(1, frames.length);
    for (const { state, from, to } of spans(frames)) {
      context.fillStyle = stateColor(state, theme());
      const tall = HEIGHTS[state] * height;
      context.fillRect(from * unit, height - tall, Math.max(1, (to - from + 1) * unit), tall);
    }
  }
}
