/** Work on the whole map: adjusting it, joining another session's to it, with how far it is. */

import { beginMerge, beginOptimize, cancelOperation, listOperations, listSessions, type Operation, type Session } from '../data/api';
import { announce, h } from '../dom';

/** Time between two looks at an operation that runs, ms. */
const LOOK_INTERVAL_MS = 500;

const goesOn = ({ state }: Operation) => state === 'queued' || state === 'running';

/** What is to be read about an operation. */
export function told(operation: Operation): string {
  const name = operation.kind === 'merge' ? `Joining ${operation.from_session_id ?? 'another session'}` : 'Optimizing the map';
  if (operation.state === 'queued') return `${name}: waits for its turn.`;
  if (operation.state === 'running') return `${name}: ${Math.round(operation.progress * 100)} %.`;
  if (operation.state === 'cancelled') return `${name}: cancelled, nothing was changed.`;
  return operation.message;
}

export class OperationsPanel {
  readonly element: HTMLElement;
  readonly #optimize = h('button', { type: 'button', onclick: () => void this.#begin(() => beginOptimize(this.id)) }, 'Optimize');
  readonly #other = h('select', { id: 'other-session', onfocus: () => void this.#offerSessions() }, h('option', { value: '' }, 'another session…'));
  readonly #merge: HTMLFormElement;
  readonly #progress = h('progress', { max: 1, value: 0, 'aria-label': 'Share that is done', hidden: true });
  readonly #cancel = h('button', { type: 'button', hidden: true, onclick: () => void this.#stop() }, 'Cancel');
  readonly #text = h('p', { class: 'note', role: 'status' });
  #running: Operation | null = null;
  #timer = 0;
  #closed = false;

  constructor(
    private readonly id: string,
    /** Called when an operation has ended: the map may be another one. */
    private readonly onEnd: () => void,
  ) {
    const submit = (event: Event) => {
      event.preventDefault();
      const from = this.#other.value;
      if (from) void this.#begin(() => beginMerge(this.id, from));
      else this.#say('Choose the session whose map is to be joined to this one.');
    };
    const label = h('label', { for: 'other-session' }, 'Join with ');
    this.#merge = h('form', { class: 'row', onsubmit: submit }, label, this.#other, h('button', { type: 'submit' }, 'Join'));
    this.element = h('section', { class: 'panel', 'aria-label': 'Whole map' }, h('h2', {}, 'Whole map'), h('div', { class: 'row' }, this.#optimize, this.#progress, this.#cancel), this.#merge, this.#text);
    void this.#look();
  }

  /** A map that a stream is working on is left alone. */
  update(session: Session): void {
    const idle = !session.has_writer && this.#running === null;
    for (const control of this.#merge.elements) (control as HTMLButtonElement).disabled = !idle;
    this.#optimize.disabled = !idle;
    this.#optimize.title = session.has_writer ? 'While images come in, the map is adjusted as it grows.' : '';
  }

  close(): void {
    this.#closed = true;
    clearTimeout(this.#timer);
  }

  async #offerSessions(): Promise<void> {
    const { sessions } = await listSessions('').catch(() => ({ sessions: [] as Session[] }));
    const chosen = this.#other.value;
    const options = sessions.filter(({ id }) => id !== this.id).map(({ id }) => h('option', { value: id }, id));
    this.#other.replaceChildren(h('option', { value: '' }, 'another session…'), ...options);
    this.#other.value = chosen;
  }

  async #begin(begin: () => Promise<Operation>): Promise<void> {
    try {
      this.#take(await begin());
    } catch (error) {
      this.#say(error instanceof Error ? error.message : 'It cannot be begun now.');
    }
  }

  async #stop(): Promise<void> {
    if (!this.#running) return;
    try {
      this.#take(await cancelOperation(this.#running.id));
    } catch (error) {
      this.#say(error instanceof Error ? error.message : 'It cannot be cancelled now.');
    }
  }

  /** Looks for an operation that others began, or how far the one that is known is. */
  async #look(): Promise<void> {
    try {
      const operations = await listOperations(this.id);
      const known = operations.find(({ id }) => id === this.#running?.id);
      const one = operations.find(goesOn) ?? known;
      if (one) this.#take(one);
      else if (this.#running) this.#take({ ...this.#running, state: 'failed', message: 'The server knows nothing of it any more: it was started again meanwhile, and the map is as it was.' });
    } catch {
      // The next look asks again.
      if (this.#running) this.#lookAgain();
    }
  }

  #take(operation: Operation): void {
    if (this.#closed) return;
    const going = goesOn(operation);
    const ended = this.#running !== null && !going;
    this.#running = going ? operation : null;
    this.#progress.hidden = this.#cancel.hidden = !going;
    this.#progress.value = operation.progress;
    this.#optimize.disabled = going;
    this.#say(told(operation));
    if (going) this.#lookAgain();
    if (ended) {
      announce(told(operation));
      this.onEnd();
    }
  }

  #lookAgain(): void {
    clearTimeout(this.#timer);
    if (!this.#closed) this.#timer = window.setTimeout(() => void this.#look(), LOOK_INTERVAL_MS);
  }

  #say(sentence: string): void {
    this.#text.textContent = sentence;
  }
}
