/** What the page shows, as the part of the address after `#`: any state can be sent to a colleague. */

export const LAYERS = ['points', 'lines', 'keyframes', 'trajectory', 'covisibility', 'primitives'] as const;
export type Layer = (typeof LAYERS)[number];

/** Where the reader stands in the map and what he looks at. */
export interface Eye {
  position: [number, number, number];
  target: [number, number, number];
}

/** A session's state of view. */
export interface SessionAddress {
  page: 'session';
  id: string;
  /** The frame shown; `null` for the newest. */
  frame: number | null;
  keyframe: number | null;
  hidden: Layer[];
  eye: Eye | null;
  follow: boolean;
}

export type Address = { page: 'list' } | SessionAddress;

/** Layers that are not shown unless asked for: too many strokes for a first look. */
export const HIDDEN_AT_FIRST: Layer[] = ['covisibility', 'primitives'];

/** The state of a session that was just opened. */
export function openSession(id: string): SessionAddress {
  return { page: 'session', id, frame: null, keyframe: null, hidden: HIDDEN_AT_FIRST, eye: null, follow: false };
}

function wholeNumber(text: string | null): number | null {
  return text !== null && /^\d{1,15}$/.test(text) ? Number(text) : null;
}

function parseEye(text: string | null): Eye | null {
  const numbers = (text ?? '').split(',').map(Number);
  const [a, b, c, d, e, f] = numbers;
  if (numbers.length !== 6 || !numbers.every(Number.isFinite)) {
    return null;
  }
  return { position: [a!, b!, c!], target: [d!, e!, f!] };
}

/** Reads an address; what cannot be understood is as in a session that was just opened. */
export function parseAddress(hash: string): Address {
  const [path = '', query = ''] = hash.replace(/^#/, '').split('?');
  const match = /^\/s\/([A-Za-z0-9_-]{1,64})$/.exec(path);
  if (!match?.[1]) {
    return { page: 'list' };
  }
  const state = openSession(match[1]);
  const params = new URLSearchParams(query);
  const show = params.get('show');
  if (show !== null) {
    const shown = show.split('.');
    state.hidden = LAYERS.filter((layer) => !shown.includes(layer));
  }
  state.frame = wholeNumber(params.get('frame'));
  state.keyframe = wholeNumber(params.get('keyframe'));
  state.eye = parseEye(params.get('eye'));
  state.follow = params.get('follow') === '1';
  return state;
}

function short(value: number): string {
  return String(Number(value.toPrecision(5)));
}

/** Reverses {@link parseAddress}; what is as at first is left out. */
export function formatAddress(address: Address): string {
  if (address.page === 'list') {
    return '#/';
  }
  const parts: string[] = [];
  if (address.frame !== null) parts.push(`frame=${address.frame}`);
  if (address.keyframe !== null) parts.push(`keyframe=${address.keyframe}`);
  const asAtFirst = LAYERS.every((layer) => address.hidden.includes(layer) === HIDDEN_AT_FIRST.includes(layer));
  if (!asAtFirst) {
    parts.push(`show=${LAYERS.filter((layer) => !address.hidden.includes(layer)).join('.')}`);
  }
  if (address.follow) parts.push('follow=1');
  if (address.eye) {
    parts.push(`eye=${[...address.eye.position, ...address.eye.target].map(short).join(',')}`);
  }
  return `#/s/${address.id}${parts.length > 0 ? `?${parts.join('&')}` : ''}`;
}
