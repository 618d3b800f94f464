/** The selected keyframe: which, and what it ties. */

import { getEdges, type Edge } from '../data/api';
import type { Scene } from '../data/scene';
import { h } from '../dom';

/** Neighbors named at most. */
const MAX_NEIGHBORS = 8;

export class KeyframePanel {
  readonly element: HTMLElement;
  readonly #input = h('input', { type: 'number', id: 'keyframe-number', min: 1, step: 1, inputmode: 'numeric' });
  readonly #body = h('div', { 'aria-live': 'polite' });
  #shown: number | null = null;

  constructor(
    private readonly id: string,
    private readonly scene: Scene,
    private readonly onSelect: (keyframe: number | null) => void,
  ) {
    this.#input.addEventListener('change', () => this.onSelect(this.#input.value === '' ? null : Number(this.#input.value)));
    const button = (text: string, name: string, step: 1 | -1) =>
      h('button', { type: 'button', 'aria-label': name, onclick: () => this.#step(step) }, text);
    const chooser = h(
      'div',
      { class: 'row' },
      h('label', { for: 'keyframe-number' }, 'Number '),
      this.#input,
      button('‹', 'Keyframe before', -1),
      button('›', 'Next keyframe', 1),
      h('button', { type: 'button', onclick: () => this.onSelect(null) }, 'None'),
    );
    this.element = h('section', { class: 'panel', 'aria-label': 'Keyframe' }, h('h2', {}, 'Keyframe'), chooser, this.#body);
  }

  /** Shows a keyframe; with `again`, also one that is shown already. */
  update(keyframe: number | null, again: boolean): void {
    this.#input.value = keyframe === null ? '' : String(keyframe);
    if (keyframe === this.#shown && !again) return;
    this.#shown = keyframe;
    const row = keyframe === null ? undefined : this.scene.keyframes.get(keyframe);
    if (!row) {
      const known = this.scene.revision !== null;
      const text = keyframe === null ? 'Choose one in the map or by its number.' : known ? `There is no keyframe ${keyframe}, or no longer.` : 'Loading…';
      this.#body.replaceChildren(h('p', { class: 'note' }, text));
      return;
    }
    void this.#describe(row.id, row.sequence, row.submap);
  }

  #step(step: 1 | -1): void {
    const ids = [...this.scene.keyframes.keys()].sort((a, b) => a - b);
    const next = step > 0 ? ids.find((id) => id > (this.#shown ?? 0)) : ids.findLast((id) => id < (this.#shown ?? Infinity));
    if (next !== undefined) this.onSelect(next);
  }

  async #describe(id: number, sequence: number, submap: number): Promise<void> {
    let edges: Edge[] | null = null;
    try {
      edges = await getEdges(this.id, 1, id);
    } catch {
      // Said below.
    }
    if (this.#shown !== id) return;
    const neighbors = (edges ?? [])
      .map((edge) => ({ ...edge, other: edge.from === id ? edge.to : edge.from }))
      .sort((a, b) => b.weight - a.weight);
    const links = neighbors.slice(0, MAX_NEIGHBORS).map((edge) => {
      const open = () => this.onSelect(edge.other);
      const text = `${edge.other}`;
      const name = `Keyframe ${edge.other}: ${edge.n_points} points and ${edge.n_lines} lines in common`;
      return h('button', { type: 'button', class: 'chip', title: name, 'aria-label': name, onclick: open }, text);
    });
    const primitives = [...this.scene.primitives.values()].filter((row) => row.keyframes.includes(id));
    const only = new Set(primitives.flatMap((row) => row.keyframes));
    neighbors.forEach((edge) => only.delete(edge.other));
    only.delete(id);
    const ties = edges
      ? `Shares landmarks with ${neighbors.length} keyframes; most with `
      : 'What it shares with others cannot be read now.';
    const shown = primitives.map((row) => row.id).join(', ');
    this.#body.replaceChildren(
      h('p', { class: 'note' }, `Keyframe ${id} is frame ${sequence} in submap ${submap}.`),
      h('p', { class: 'note' }, ties, ...links),
      h('p', { class: 'note' }, primitives.length > 0 ? `Shows global primitives ${shown}, which tie it to ${only.size} keyframes it shares no landmark with.` : 'Shows no global primitive.'),
    );
  }
}
