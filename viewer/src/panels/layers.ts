/** What is drawn, with its colors: the legend, each entry of which turns a layer on and off. */

import { LAYERS, type Layer } from '../address';
import { palette, primitiveColor, submapColor } from '../colors';
import type { Scene } from '../data/scene';
import { count, h } from '../dom';
import { theme } from '../theme';

const NAMES: Record<Layer, string> = {
  points: 'Points',
  lines: 'Lines',
  keyframes: 'Keyframes',
  trajectory: 'Trajectory',
  covisibility: 'Covisibility',
  primitives: 'Primitive ties',
};

/** Primitives named in the legend at most: as many as there are colors. */
const MAX_NAMED = 7;

export class Layers {
  readonly element: HTMLElement;
  readonly #keys = h('div', { class: 'keys' });
  readonly #boxes = new Map<Layer, HTMLInputElement>();

  constructor(onChange: (hidden: Layer[]) => void) {
    const rows = LAYERS.map((layer) => {
      const box = h('input', { type: 'checkbox', id: `layer-${layer}` });
      box.addEventListener('change', () => onChange(this.#hidden()));
      this.#boxes.set(layer, box);
      return h('label', { class: 'layer', for: box.id }, box, ` ${NAMES[layer]}`);
    });
    this.element = h(
      'details',
      { class: 'layers', open: matchMedia('(min-width: 700px)').matches },
      h('summary', {}, 'Legend'),
      h('fieldset', {}, h('legend', { class: 'visually-hidden' }, 'Shown'), ...rows),
      this.#keys,
    );
  }

  update(hidden: Layer[], scene: Scene, primitiveEdges: { drawn: number; total: number }): void {
    this.#boxes.forEach((box, layer) => (box.checked = !hidden.includes(layer)));
    const now = theme();
    const named = [...scene.primitives.keys()].slice(0, MAX_NAMED);
    const more = scene.primitives.size - named.length;
    const rows = [
      key('dot', '#9a9a9a', "points: the images' gray"),
      ...named.map((id) => key('line', primitiveColor(id, now), `lines of primitive ${id}`)),
      more > 0 ? h('p', { class: 'note' }, `and of ${more} more primitives, the colors in turn`) : null,
      key('line', primitiveColor(null, now), 'lines of none'),
      ...scene.submaps().map((submap) => key('line', submapColor(submap, now), `trajectory, submap ${submap}`)),
      key('dash', submapColor(scene.submaps()[0] ?? 0, now), 'dashed: placed afterwards'),
      hidden.includes('covisibility') ? null : key('line', palette(now).covisibility, 'keyframes that share landmarks'),
      hidden.includes('primitives') ? null : key('line', palette(now).primitiveEdge, primitiveText(primitiveEdges)),
      scene.submaps().length > 1 ? h('p', { class: 'note' }, 'Submaps share no frame of reference: they are drawn side by side.') : null,
    ];
    this.#keys.replaceChildren(...rows.filter((row) => row !== null));
  }

  #hidden(): Layer[] {
    return LAYERS.filter((layer) => !this.#boxes.get(layer)?.checked);
  }
}

function primitiveText({ drawn, total }: { drawn: number; total: number }): string {
  const which = drawn < total ? ` (${count(drawn)} of ${count(total)} drawn)` : '';
  return `keyframes only a primitive ties${which}`;
}

function key(kind: 'dot' | 'line' | 'dash', color: string, text: string): HTMLElement {
  const mark = h('span', { class: `mark ${kind}`, 'aria-hidden': 'true' });
  mark.style.setProperty('--color', color);
  return h('p', { class: 'key' }, mark, text);
}
