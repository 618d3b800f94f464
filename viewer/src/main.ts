/** The viewer of a monoslam server: begins here. */

import './style.css';
import { parseAddress } from './address';
import { h } from './dom';
import { ListPage } from './list';
import { SessionPage } from './session';
import { setUpTheme } from './theme';

const main = document.getElementById('main')!;
const crumbs = document.getElementById('crumbs')!;

let page: ListPage | SessionPage | null = null;
let shownSession: string | null = null;

function show(): void {
  const address = parseAddress(location.hash);
  if (address.page === 'session' && page instanceof SessionPage && shownSession === address.id) {
    page.update(address);
    return;
  }
  page?.close();
  shownSession = address.page === 'session' ? address.id : null;
  document.title = shownSession === null ? 'monoslam' : `${shownSession} · monoslam`;
  crumbs.replaceChildren(
    h('a', { href: '#/', ...(shownSession === null ? { 'aria-current': 'page' } : {}) }, 'Sessions'),
    ...(shownSession === null ? [] : [h('span', { 'aria-hidden': 'true' }, '/'), h('span', { 'aria-current': 'page' }, shownSession)]),
  );
  page = address.page === 'session' ? new SessionPage(main, address) : new ListPage(main);
}

setUpTheme(document.getElementById('theme') as HTMLButtonElement);
window.addEventListener('hashchange', show);
show();
