/** The viewer of a monoslam server: begins here. */

import './style.css';
import { openSession, parseAddress } from './address';
import { admit, takeTokenFromAddress } from './data/access';
import { embedded } from './data/embedded';
import { h } from './dom';
import { ListPage } from './list';
import { SessionPage } from './session';
import { setUpTheme } from './theme';

const main = document.getElementById('main')!;
const crumbs = document.getElementById('crumbs')!;

let page: ListPage | SessionPage | null = null;
let shownSession: string | null = null;

function show(): void {
  const named = parseAddress(location.hash);
  const address = embedded && named.page === 'list' ? openSession(embedded.session.id) : named;
  if (address.page === 'session' && page instanceof SessionPage && shownSession === address.id) {
    page.update(address);
    return;
  }
  page?.close();
  shownSession = address.page === 'session' ? address.id : null;
  page = address.page === 'session' ? new SessionPage(main, address) : new ListPage(main);
  // A report has a title of its own and no other sessions.
  if (embedded) return;
  document.title = shownSession === null ? 'monoslam' : `${shownSession} · monoslam`;
  crumbs.replaceChildren(
    h('a', { href: '#/', ...(shownSession === null ? { 'aria-current': 'page' } : {}) }, 'Sessions'),
    ...(shownSession === null ? [] : [h('span', { 'aria-hidden': 'true' }, '/'), h('span', { 'aria-current': 'page' }, shownSession)]),
  );
}

/** Pictures of keyframes are in the report once, and shown wherever it names them. */
function fillPictures(): void {
  for (const image of document.querySelectorAll<HTMLImageElement>('img[data-keyframe]')) {
    const kept = embedded?.images[image.dataset['keyframe'] ?? ''];
    if (kept) image.src = kept.image;
  }
}

setUpTheme(document.getElementById('theme') as HTMLButtonElement);
window.addEventListener('hashchange', show);
fillPictures();
if (embedded) {
  show();
} else {
  takeTokenFromAddress();
  void admit().then(show);
}
