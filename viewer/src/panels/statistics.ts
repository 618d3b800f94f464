/** Figures of a session: of the last frame, and of its map. */

import type { Session } from '../data/api';
import type { FrameEvent } from '../data/live';
import type { Scene } from '../data/scene';
import { count, h } from '../dom';

/** Time over which frames are counted for their rate, ms. */
const RATE_WINDOW_MS = 3000;

export class Statistics {
  readonly element: HTMLElement;
  readonly #list = h('dl', { class: 'figures' });
  readonly #corrections = h('ul', { class: 'note corrections', 'aria-label': 'Corrections of the map' });
  #arrivals: number[] = [];
  #last: FrameEvent | null = null;

  constructor() {
    this.element = h('section', { class: 'panel', 'aria-label': 'Statistics' }, h('h2', {}, 'Statistics'), this.#list, this.#corrections);
  }

  frame(event: FrameEvent): void {
    const now = performance.now();
    this.#last = event;
    this.#arrivals = [...this.#arrivals.filter((time) => now - time < RATE_WINDOW_MS), now];
    for (const { matched_keyframe, submap_gone } of event.corrections) {
      const what =
        submap_gone !== null
          ? `submap ${submap_gone} merged`
          : matched_keyframe !== null
            ? `loop closed with keyframe ${matched_keyframe}`
            : 'calibration looked at';
      this.#corrections.prepend(h('li', {}, `Frame ${event.sequence}: ${what}.`));
      while (this.#corrections.children.length > 5) this.#corrections.lastChild?.remove();
    }
  }

  update(session: Session, scene: Scene): void {
    const now = performance.now();
    const arrivals = this.#arrivals.filter((time) => now - time < RATE_WINDOW_MS);
    const span = arrivals.length > 1 ? (arrivals.at(-1)! - arrivals[0]!) / 1000 : 0;
    const live = session.has_writer && this.#last;
    const entries: [string, string][] = [
      ['State', session.state ?? 'no frame yet'],
      ['Frames', count(scene.frames.size || session.n_frames)],
      ['Keyframes', count(scene.keyframes.size)],
      ['Points', count(scene.points.size)],
      ['Lines', count(scene.lines.size)],
      ['Global primitives', count(scene.primitives.size)],
      ['Submaps', count(scene.submaps().length)],
      ['Scale', session.metres_per_unit === null ? 'free (map units)' : `${Number(session.metres_per_unit.toPrecision(4))} m a unit`],
      ['Saved up to frame', session.durable_sequence === null ? 'none' : String(session.durable_sequence)],
    ];
    if (session.found_readout) {
      const { readout_ms, sigma_ms } = session.found_readout;
      entries.push(['Rolling shutter', `${readout_ms.toFixed(1)} ± ${sigma_ms.toFixed(1)} ms`]);
    }
    if (live) {
      entries.splice(
        2,
        0,
        ['Frames a second', span > 0 ? ((arrivals.length - 1) / span).toFixed(1) : 'waiting'],
        ['Time a frame', `${live.wall_ms.toFixed(1)} ms`],
        ['Keypoints, segments', `${live.n_keypoints}, ${live.n_segments}`],
        ['Points, lines in the pose', `${live.n_inlier_points}, ${live.n_inlier_lines}`],
      );
    }
    this.#list.replaceChildren(...entries.flatMap(([name, value]) => [h('dt', {}, name), h('dd', {}, value)]));
  }
}
