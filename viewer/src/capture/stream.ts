/** Sends frames over a WebSocket and goes on after broken connections. */

import { renewTicket } from '../data/access';
import { sessionPath, type Session, type State } from '../data/api';
import { Ledger, type Shot } from './ledger';

const FIRST_BACKOFF_MS = 200;
const MAX_BACKOFF_MS = 5000;

/** How long the server may take to save the map after the last frame, ms. */
const FINISH_PATIENCE_MS = 30_000;

export interface CameraFinding {
  /** Relative change of the focal length. */
  focal: number;
  /** Whether the map was adjusted to it; otherwise the field of view is too far off. */
  adopted: boolean;
}

export interface FrameAnswer {
  sequence: number;
  state: State;
  reason: string;
  is_key_frame: boolean;
  n_keypoints: number;
  n_inlier_points: number;
  n_inlier_lines: number;
  submap_id: number;
  wall_ms: number;
  corrections: { camera: CameraFinding | null }[];
}

type Message =
  | { type: 'opened'; session: Session & { next_sequence: number } }
  | ({ type: 'result'; durable_sequence: number | null } & FrameAnswer)
  | { type: 'repeated'; sequence: number; durable_sequence: number | null }
  | { type: 'dropped'; sequence: number }
  | { type: 'rejected'; sequence: number; reason: string }
  | { type: 'error'; problem: { detail: string; code: string } };

export interface Listener {
  /** The connection is there, or not. */
  onConnected(isConnected: boolean): void;
  /** A frame was tracked, or tried to be; each is told once. */
  onAnswer(answer: FrameAnswer): void;
  /** A frame was not used, and why. */
  onUnused(reason: string): void;
  /** The stream has ended, with an error or because it was finished. */
  onEnd(error: string | null): void;
}

/** Errors after which the same request may succeed. */
const PASSING = new Set(['SHUTTING_DOWN', 'STORAGE_FAILED']);

export class FrameStream {
  readonly #ledger = new Ledger();
  #socket: WebSocket | null = null;
  #hasOpened = false;
  #isFinishing = false;
  /** The connection that was told that there are no more frames. */
  #finishedOn: WebSocket | null = null;
  #hasEnded = false;
  #failures = 0;
  #timer = 0;

  constructor(
    private readonly id: string,
    private readonly listener: Listener,
  ) {
    this.#connect();
  }

  /** Whether a frame taken now would be sent at once. */
  get hasRoom(): boolean {
    return !this.#isFinishing && this.#ledger.hasRoom;
  }

  /** Frames that are kept in case they must be sent again. */
  get nHeld(): number {
    return this.#ledger.nHeld;
  }

  send(shot: Shot): void {
    this.#ledger.add(shot);
    this.#pump();
  }

  /** There are no more frames: what is on its way is answered and the map saved. */
  finish(): void {
    this.#isFinishing = true;
    this.#pump();
    this.#timer = window.setTimeout(() => this.#end(null), FINISH_PATIENCE_MS);
  }

  #connect(): void {
    const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
    // After a broken connection the server may not know yet that the last one is gone.
    const takeOver = this.#hasOpened ? '&take_over=true' : '';
    const socket = new WebSocket(`${scheme}://${location.host}${sessionPath(this.id)}/stream?policy=realtime${takeOver}`);
    this.#socket = socket;
    socket.addEventListener('message', (event) => this.#receive(JSON.parse(String(event.data)) as Message));
    socket.addEventListener('close', () => this.#closed());
  }

  #receive(message: Message): void {
    if (message.type === 'opened') {
      this.#hasOpened = true;
      this.#failures = 0;
      this.#ledger.opened(message.session.next_sequence);
      this.listener.onConnected(true);
    } else if (message.type === 'error') {
      if (!PASSING.has(message.problem.code)) this.#end(message.problem.detail);
    } else {
      this.#answered(message);
    }
    this.#pump();
  }

  #answered(message: Exclude<Message, { type: 'opened' | 'error' }>): void {
    const isKept = message.type === 'result' || message.type === 'repeated';
    if (!this.#ledger.answered(message.sequence, isKept, isKept ? message.durable_sequence : null)) return;
    if (message.type === 'result') this.listener.onAnswer(message);
    else if (message.type === 'rejected') this.listener.onUnused(message.reason);
    else if (message.type === 'dropped') this.listener.onUnused('the server had no time for a frame');
  }

  #pump(): void {
    const socket = this.#socket;
    if (socket?.readyState !== WebSocket.OPEN) return;
    for (let taken = this.#ledger.take(); taken; taken = this.#ledger.take()) {
      const [sequence, shot] = taken;
      const head = new DataView(new ArrayBuffer(16));
      head.setBigUint64(0, BigInt(sequence), true);
      head.setBigInt64(8, shot.timestampNs, true);
      socket.send(new Blob([head, shot.image]));
    }
    if (this.#isFinishing && this.#ledger.nUnanswered === 0 && this.#finishedOn !== socket) {
      this.#finishedOn = socket;
      socket.send('finish');
    }
  }

  #closed(): void {
    this.#socket = null;
    this.#ledger.disconnected();
    if (this.#hasEnded) return;
    if (this.#isFinishing && this.#ledger.nUnanswered === 0) {
      this.#end(null);
      return;
    }
    this.listener.onConnected(false);
    const wait = Math.min(FIRST_BACKOFF_MS * 2 ** this.#failures, MAX_BACKOFF_MS);
    this.#failures += 1;
    window.setTimeout(() => void renewTicket().then(() => !this.#hasEnded && this.#connect()), wait);
  }

  #end(error: string | null): void {
    if (this.#hasEnded) return;
    this.#hasEnded = true;
    clearTimeout(this.#timer);
    this.#socket?.close();
    this.listener.onEnd(error);
  }
}
