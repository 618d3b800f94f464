/** The list of sessions with small pictures. */

import { formatAddress, openSession } from './address';
import { listSessions, sessionPath, type Session } from './data/api';
import { count, h } from './dom';

/** Time between two readings of the list, ms. */
const INTERVAL_MS = 3000;

export class ListPage {
  readonly #list = h('ul', { class: 'cards', 'aria-label': 'Sessions' });
  readonly #text = h('p', { class: 'note', role: 'status' }, 'Loading…');
  readonly #more = h('button', { type: 'button', hidden: true, onclick: () => this.#showMore() }, 'More sessions');
  readonly #cards = new Map<string, HTMLElement>();
  readonly #abort = new AbortController();
  #pages = 1;
  #timer = 0;

  constructor(private readonly root: HTMLElement) {
    root.replaceChildren(h('section', { class: 'list' }, h('div', { class: 'row' }, h('h1', {}, 'Sessions'), h('a', { href: '/capture' }, 'Use this device’s camera')), this.#text, this.#list, this.#more));
    void this.#read();
  }

  close(): void {
    this.#abort.abort();
    clearTimeout(this.#timer);
  }

  #showMore(): void {
    this.#pages += 1;
    clearTimeout(this.#timer);
    void this.#read();
  }

  async #read(): Promise<void> {
    try {
      const sessions: Session[] = [];
      let token: string | null = '';
      for (let page = 0; page < this.#pages && token !== null; page += 1) {
        const answer = await listSessions(token, this.#abort.signal);
        sessions.push(...answer.sessions);
        token = answer.next_page_token;
      }
      this.#more.hidden = token === null;
      this.#show(sessions);
    } catch (error) {
      if (this.#abort.signal.aborted) return;
      const sentence = error instanceof Error ? error.message : '';
      this.#text.textContent = `${sentence} Trying again every ${INTERVAL_MS / 1000} seconds.`;
    }
    if (this.#abort.signal.aborted) return;
    this.#timer = window.setTimeout(() => void this.#read(), INTERVAL_MS);
  }

  #show(sessions: Session[]): void {
    this.root.querySelector('.hint')?.remove();
    this.#text.textContent = sessions.length === 1 ? 'One session.' : `${count(sessions.length)} sessions${this.#more.hidden ? '' : ' and more'}.`;
    if (sessions.length === 0) {
      this.#text.textContent = 'No sessions yet.';
      this.#text.after(h('p', { class: 'hint' }, 'Stream a recording: ', h('code', {}, 'monoslam stream path/to/recording --session kitchen')));
    }
    const kept = new Set(sessions.map((session) => session.id));
    this.#cards.forEach((card, id) => {
      if (!kept.has(id)) {
        card.remove();
        this.#cards.delete(id);
      }
    });
    sessions.forEach((session) => {
      const card = this.#cards.get(session.id) ?? newCard(session);
      this.#cards.set(session.id, card);
      fill(card, session);
      // Already there in the order of names, as a rule: only what is new moves.
      if (!card.isConnected) this.#list.append(card);
    });
  }
}

function newCard(session: Session): HTMLElement {
  const picture = h('img', { alt: '', loading: 'lazy', width: 320, height: 240 });
  picture.addEventListener('error', () => picture.classList.add('missing'));
  picture.addEventListener('load', () => picture.classList.remove('missing'));
  const text = h('span', { class: 'card-text' });
  const link = h('a', { href: formatAddress(openSession(session.id)) }, picture, text);
  return h('li', {}, link);
}

function fill(card: HTMLElement, session: Session): void {
  const picture = card.querySelector('img')!;
  // Another address when there may be another picture; the server says whether it is.
  const source = `${sessionPath(session.id)}/picture?keyframes=${session.n_keyframes}`;
  if (session.n_keyframes > 0 && picture.getAttribute('src') !== source) picture.src = source;
  picture.classList.toggle('missing', session.n_keyframes === 0);
  const state = session.has_writer ? 'live' : session.loaded ? 'in memory' : 'stored';
  const made = new Date(session.created_at_ns / 1e6).toLocaleString();
  const submaps = session.n_submaps > 1 ? `, ${session.n_submaps} submaps` : '';
  card.querySelector('.card-text')!.replaceChildren(
    h('strong', {}, session.id),
    h('span', { class: `badge ${session.has_writer ? 'on' : ''}` }, state),
    h('span', { class: 'note' }, session.state ? `last frame ${session.state}` : 'no frame yet'),
    h('span', { class: 'note' }, `${count(session.n_frames)} frames, ${count(session.n_keyframes)} keyframes, ${count(session.n_points)} points, ${count(session.n_lines)} lines${submaps}`),
    h('span', { class: 'note' }, `made ${made}`),
  );
}
