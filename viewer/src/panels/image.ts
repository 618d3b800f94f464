/** The current image with its keypoints, segments and vanishing points. */

import { palette, primitiveColor } from '../colors';
import { getObserved, request, type Observed } from '../data/api';
import { h } from '../dom';

/** An image that can be shown: where it is, and what to call it. */
export interface ShownImage {
  /** Path of the frame or keyframe; its `image` and `observed` lie below. */
  path: string;
  title: string;
}

/** Families of vanishing points without a primitive, in turn. */
const FAMILY_DASHES = [[6, 4], [2, 3], [10, 3, 2, 3]];

export class ImagePanel {
  readonly element: HTMLElement;
  readonly #title = h('h2', {}, 'Image');
  readonly #canvas = h('canvas', { role: 'img', width: 4, height: 3 });
  readonly #text = h('p', { class: 'note' }, 'No image yet.');
  readonly #overlay = h('input', { type: 'checkbox', id: 'overlay', checked: true, onchange: () => this.#draw() });
  #path = '';
  #abort = new AbortController();
  #busy = false;
  #next: ShownImage | null = null;
  #bitmap: ImageBitmap | null = null;
  #observed: Observed | null = null;

  constructor() {
    const label = h('label', { for: 'overlay' }, this.#overlay, ' features');
    this.element = h('section', { class: 'panel image', 'aria-label': 'Image' }, h('div', { class: 'row' }, this.#title, label), this.#canvas, this.#text);
  }

  /** Shows an image. While one is being fetched only the newest wish is remembered. */
  show(image: ShownImage | null): void {
    if (!image) {
      this.#path = '';
      this.#bitmap = null;
      this.#text.textContent = 'No image yet: images of keyframes are shown here, and of frames as they come in.';
      this.#draw();
      return;
    }
    if (image.path === this.#path) {
      this.#title.textContent = image.title;
      return;
    }
    this.#next = image;
    if (!this.#busy) void this.#fetchNext();
  }

  close(): void {
    this.#abort.abort();
  }

  redraw(): void {
    this.#draw();
  }

  async #fetchNext(): Promise<void> {
    this.#busy = true;
    while (this.#next) {
      const { path, title } = this.#next;
      this.#next = null;
      try {
        const signal = this.#abort.signal;
        const [response, observed] = await Promise.all([request(`${path}/image`, { signal }), getObserved(path, signal)]);
        const bitmap = await createImageBitmap(await response.blob());
        [this.#path, this.#bitmap, this.#observed] = [path, bitmap, observed];
        this.#title.textContent = title;
        this.#draw();
      } catch {
        // A frame that is no longer kept: the next one is about to come.
      }
    }
    this.#busy = false;
  }

  #draw(): void {
    const [canvas, bitmap, observed] = [this.#canvas, this.#bitmap, this.#observed];
    canvas.hidden = !bitmap;
    if (!bitmap) return;
    const factor = Math.max(1, Math.round(900 / bitmap.width));
    canvas.width = bitmap.width * factor;
    canvas.height = bitmap.height * factor;
    const context = canvas.getContext('2d')!;
    context.drawImage(bitmap, 0, 0, canvas.width, canvas.height);
    if (!observed) return;
    const scale = canvas.width / observed.width;
    if (this.#overlay.checked) {
      drawSegments(context, observed, scale);
      drawKeypoints(context, observed, scale);
      drawVanishing(context, observed, scale);
    }
    const text = describe(observed);
    this.#text.textContent = text;
    canvas.setAttribute('aria-label', `${this.#title.textContent}. ${text}`);
  }
}

/** What the image shows, in words. */
export function describe(observed: Observed): string {
  const seen = (ids: (number | null)[]) => ids.filter((id) => id !== null).length;
  const { keypoints, point_ids, segments, line_ids, primitive_ids, vanishing_points } = observed;
  const families = vanishing_points.length > 0 ? `, ${vanishing_points.length} vanishing points` : '';
  return (
    `${seen(point_ids)} of ${keypoints.length} keypoints see a point, ` +
    `${seen(line_ids)} of ${segments.length} segments a line; ` +
    `${seen(primitive_ids)} run along global primitives${families}.`
  );
}

function drawKeypoints(context: CanvasRenderingContext2D, observed: Observed, scale: number): void {
  observed.keypoints.forEach(([x, y], i) => {
    const matched = observed.point_ids[i] !== null;
    context.beginPath();
    context.arc(x * scale, y * scale, matched ? 3 : 2, 0, 2 * Math.PI);
    context.fillStyle = '#3ddc84';
    context.strokeStyle = matched ? '#06301a' : 'rgba(255,255,255,0.55)';
    context.lineWidth = 1;
    if (matched) context.fill();
    context.stroke();
  });
}

function drawSegments(context: CanvasRenderingContext2D, observed: Observed, scale: number): void {
  observed.segments.forEach(([x1, y1, x2, y2], i) => {
    const primitive = observed.primitive_ids[i] ?? null;
    const family = observed.vanishing_idx[i] ?? null;
    context.beginPath();
    context.moveTo(x1 * scale, y1 * scale);
    context.lineTo(x2 * scale, y2 * scale);
    // The image is no theme's: the dark theme's bright colors stand out on it.
    context.strokeStyle = primitive !== null ? primitiveColor(primitive, 'dark') : palette('dark').neutral;
    context.lineWidth = observed.line_ids[i] !== null ? 3 : 1.5;
    context.setLineDash(primitive === null && family !== null ? FAMILY_DASHES[family % 3]! : []);
    context.stroke();
  });
  context.setLineDash([]);
}

function drawVanishing(context: CanvasRenderingContext2D, observed: Observed, scale: number): void {
  for (const { pixel, primitive_id } of observed.vanishing_points) {
    if (!pixel || pixel[0] < 0 || pixel[1] < 0 || pixel[0] > observed.width || pixel[1] > observed.height) continue;
    const [x, y] = [pixel[0] * scale, pixel[1] * scale];
    context.strokeStyle = primitive_id === null ? '#ffffff' : primitiveColor(primitive_id, 'dark');
    context.lineWidth = 3;
    context.beginPath();
    context.moveTo(x - 10, y - 10);
    context.lineTo(x + 10, y + 10);
    context.moveTo(x + 10, y - 10);
    context.lineTo(x - 10, y + 10);
    context.arc(x, y, 14, 0, 2 * Math.PI);
    context.stroke();
  }
}

