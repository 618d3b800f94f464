/** The timeline: the states of all frames, a slider through them, and playing a session back. */

import { stateColor } from '../colors';
import type { State } from '../data/api';
import type { FrameRow, Scene } from '../data/scene';
import { count, h } from '../dom';
import { theme } from '../theme';

export interface Span {
  state: State;
  /** Whether the poses were found afterwards. */
  backfilled: boolean;
  /** First and last frame, by their places in the order of frames. */
  from: number;
  to: number;
}

/** Runs of frames of one kind. */
export function spans(frames: FrameRow[]): Span[] {
  const found: Span[] = [];
  frames.forEach(({ state, backfilled }, i) => {
    const last = found.at(-1);
    if (last?.state === state && last.backfilled === backfilled) last.to = i;
    else found.push({ state, backfilled, from: i, to: i });
  });
  return found;
}

/** How a frame is told in words. */
export function frameText(frame: FrameRow): string {
  const placed = frame.pose ? (frame.backfilled ? ', placed afterwards' : '') : ', no pose';
  // A frame placed afterwards had a reason when it came in.
  const reason = frame.reason ? `${frame.backfilled ? '; as it came in' : ''}: ${frame.reason}` : '';
  return `Frame ${frame.sequence}, ${frame.state}${placed}${reason}`;
}

const STATES: State[] = ['initialising', 'tracked', 'weak', 'lost'];
/** Shares of the strip's height by state, so that states differ by more than color. */
const HEIGHTS: Record<State, number> = { tracked: 1, weak: 0.7, initialising: 0.45, lost: 0.25 };
/** Width of a stripe of frames that were placed afterwards, with the gap beside it, pixels. */
const STRIPE_PX = 6;
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
    this.#legend.replaceChildren(
      ...STATES.map((state) => entry(state, `state-${state}`, frames.filter((frame) => frame.state === state && !frame.backfilled))),
      entry('placed afterwards', 'state-backfilled', frames.filter((frame) => frame.backfilled)),
    );
    this.#drawStrip();
  }

  close(): void {
    this.#stop();
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
    for (const { state, backfilled, from, to } of spans(frames)) {
      context.fillStyle = stateColor(state, theme());
      const [left, wide, tall] = [from * unit, Math.max(1, (to - from + 1) * unit), HEIGHTS[state] * height];
      if (!backfilled) context.fillRect(left, height - tall, wide, tall);
      for (let x = left; backfilled && x < left + wide; x += STRIPE_PX) {
        context.fillRect(x, height - tall, Math.min(STRIPE_PX / 2, left + wide - x), tall);
      }
    }
  }
}

function entry(name: string, mark: string, frames: FrameRow[]): HTMLElement {
  return h('li', {}, h('span', { class: `swatch ${mark}`, 'aria-hidden': 'true' }), `${name} ${count(frames.length)}`);
}
