/**
 * The token, where the server needs one. It is asked for once and kept in this browser. Requests carry it; events,
 * streams and pictures cannot, so that the server gives the page a ticket for them, in a cookie that scripts do not
 * see.
 */

import { h } from '../dom';

const TOKEN_KEY = 'monoslam-token';

/** A link may bring the token behind the `#`, which is not sent to any server. */
const IN_ADDRESS = /^#token=([\w-]+)$/;

/** Before the server has said how long a ticket is good. */
let renewal = 0;
let admission: Promise<void> | null = null;
let inMemory: string | null = null;

function keptToken(): string | null {
  try {
    return localStorage.getItem(TOKEN_KEY) ?? inMemory;
  } catch {
    return inMemory;
  }
}

function keepToken(token: string | null): void {
  inMemory = token;
  try {
    if (token === null) localStorage.removeItem(TOKEN_KEY);
    else localStorage.setItem(TOKEN_KEY, token);
  } catch {
    // Without storage it is asked for again the next time.
  }
}

/** The token that an address brings; `null` if it brings none. */
export function tokenIn(hash: string): string | null {
  return IN_ADDRESS.exec(hash)?.[1] ?? null;
}

/** Takes the token out of the address, so that it is not shown, kept in the history or sent to somebody. */
export function takeTokenFromAddress(): void {
  const token = tokenIn(location.hash);
  if (token === null) return;
  keepToken(token);
  history.replaceState(null, '', location.pathname + location.search);
}

/** What a request carries. */
export function authorization(): Record<string, string> {
  const token = keptToken();
  return token ? { authorization: `Bearer ${token}` } : {};
}

/** Asks for a ticket; whether the server lets this page in. It does while it cannot be reached, too. */
async function ticket(): Promise<boolean> {
  clearTimeout(renewal);
  let response: Response;
  try {
    response = await fetch('/v1/tickets', { method: 'POST', headers: authorization() });
  } catch {
    return true;
  }
  if (response.status === 401) return false;
  const answer = (await response.json().catch(() => null)) as { expires_in_s?: number | null } | null;
  const seconds = answer?.expires_in_s;
  if (seconds) renewal = window.setTimeout(() => void ticket(), Math.min(seconds * 500, 2 ** 30));
  return true;
}

/** Waits until the server lets this page in, asking for a token where one is needed. */
export function admit(): Promise<void> {
  admission ??= letIn().finally(() => (admission = null));
  return admission;
}

async function letIn(): Promise<void> {
  let hadToken = keptToken() !== null;
  while (!(await ticket())) {
    keepToken(await ask(hadToken ? 'The server does not take the token: it has run out, was revoked, or is another server’s.' : ''));
    hadToken = true;
  }
}

/** Renews the ticket before something that needs it is opened again; never fails. */
export async function renewTicket(): Promise<void> {
  if (keptToken() !== null) await ticket();
}

function ask(problem: string): Promise<string> {
  const input = h('input', { type: 'password', id: 'token', autocomplete: 'current-password', required: true, spellcheck: 'false' });
  const dialog = h('dialog', { class: 'token', 'aria-labelledby': 'token-title' });
  return new Promise((resolve) => {
    const form = h(
      'form',
      {
        onsubmit: (event) => {
          event.preventDefault();
          const token = input.value.trim();
          if (!token) return;
          dialog.remove();
          resolve(token);
        },
      },
      h('h2', { id: 'token-title' }, 'This server needs a token'),
      problem ? h('p', { class: 'problem', role: 'alert' }, problem) : null,
      h('label', { for: 'token' }, 'Token'),
      input,
      h('p', { class: 'note' }, 'Whoever runs the server makes one with ', h('code', {}, 'monoslam-server token create'), '. It is kept in this browser.'),
      h('button', { type: 'submit', class: 'go' }, 'Go on'),
    );
    // Without a token there is nothing to go back to.
    dialog.addEventListener('cancel', (event) => event.preventDefault());
    dialog.append(form);
    document.body.append(dialog);
    dialog.showModal();
    input.focus();
  });
}
