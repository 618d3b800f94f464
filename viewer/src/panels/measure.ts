/** Setting the scale: two points of the map are picked and the distance between them is given in meters. */

import { setScale, type Session } from '../data/api';
import type { Scene } from '../data/scene';
import { announce, h } from '../dom';
import type { Triple } from '../map/layout';

export interface Picked {
  id: number;
  submap: number;
  position: Triple;
}

/** Meters per map unit, if a distance in the map is so many meters. */
export function metresPerUnit(units: number, metres: number): number | null {
  const scale = metres / units;
  return units > 0 && metres > 0 && Number.isFinite(scale) ? scale : null;
}

export class MeasurePanel {
  readonly element: HTMLElement;
  /** Whether clicks in the map pick points. */
  picking = false;
  picked: Picked[] = [];
  readonly #start = h('button', { type: 'button', 'aria-pressed': 'false', onclick: () => this.#toggle() }, 'Pick two points');
  readonly #text = h('p', { class: 'note', 'aria-live': 'polite' });
  readonly #metres = h('input', { type: 'number', id: 'metres', min: 0, step: 'any', inputmode: 'decimal' });
  readonly #form: HTMLFormElement;
  readonly #free = h('button', { type: 'button', onclick: () => void this.#send(null) }, 'Free the scale');

  constructor(
    private readonly id: string,
    private readonly scene: Scene,
    private readonly onChange: () => void,
    private readonly onSession: (session: Session) => void,
  ) {
    const submit = (event: Event) => {
      event.preventDefault();
      const scale = metresPerUnit(this.#distance() ?? 0, Number(this.#metres.value));
      if (scale === null) this.#text.textContent = 'Give a distance above 0, in meters.';
      else void this.#send(scale);
    };
    const label = h('label', { for: 'metres' }, 'They are ');
    this.#form = h('form', { class: 'row', onsubmit: submit, hidden: true }, label, this.#metres, h('span', {}, ' m apart'), h('button', { type: 'submit' }, 'Set scale'));
    this.element = h('section', { class: 'panel', 'aria-label': 'Scale' }, h('h2', {}, 'Scale'), h('div', { class: 'row' }, this.#start, this.#free), this.#text, this.#form);
    this.update();
  }

  /** Takes a point that was clicked at. */
  pick(point: Picked): void {
    if (this.picked.some(({ id }) => id === point.id)) {
      announce('That is the first point again.');
      return;
    }
    this.picked.push(point);
    announce(`Point ${point.id} picked.`);
    if (this.picked.length === 2) this.#toggle();
    this.update();
    this.onChange();
    if (!this.#form.hidden) this.#metres.focus();
  }

  update(): void {
    const [first, second] = this.picked;
    const distance = this.#distance();
    this.#free.hidden = this.scene.metresPerUnit === null;
    this.#form.hidden = distance === null;
    const how = 'Click a point of the map, or turn the map by arrow keys and press Enter for the point in its middle.';
    let text = this.picking ? `${how} ${first ? 'One more.' : ''}` : 'One camera does not see scale: say how far two points are apart.';
    if (second) text = distance === null ? 'These points are in two submaps, whose scales differ. Pick two of one.' : this.#told(distance);
    this.#text.textContent = text;
  }

  #told(distance: number): string {
    const metres = this.scene.metresPerUnit === null ? '' : `, ${Number((distance * this.scene.metresPerUnit).toPrecision(4))} m`;
    return `Points ${this.picked.map((point) => point.id).join(' and ')} are ${Number(distance.toPrecision(4))} map units apart${metres}.`;
  }

  #distance(): number | null {
    const [a, b] = this.picked;
    if (!a || !b || a.submap !== b.submap) return null;
    return Math.hypot(...a.position.map((length, i) => length - b.position[i]!));
  }

  #toggle(): void {
    this.picking = !this.picking;
    if (this.picking) this.picked = [];
    this.#start.setAttribute('aria-pressed', String(this.picking));
    this.update();
    this.onChange();
  }

  async #send(scale: number | null): Promise<void> {
    try {
      const session = await setScale(this.id, scale);
      this.scene.metresPerUnit = session.metres_per_unit;
      this.onSession(session);
      this.update();
      announce(scale === null ? 'The scale is free.' : 'The scale is set.');
    } catch (error) {
      this.#text.textContent = error instanceof Error ? error.message : 'The scale cannot be set now.';
    }
  }
}
