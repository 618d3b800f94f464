/** Keeps a scene up to date: reads it, follows the session's events, and reads what changed after a pause. */

import { ApiProblem, request, sessionPath, type Session, type State } from './api';
import { embedded } from './embedded';
import { linesOf, type Pose, type ScenePart } from './parts';
import type { FrameRow, Scene } from './scene';

/** Time between two readings of what changed, ms: drawing a large map anew takes a part of it. */
const MIN_READING_INTERVAL_MS = 500;
/** Time before the first new attempt when the server is away, ms; doubled up to the longest. */
const FIRST_RETRY_MS = 1000;
const LONGEST_RETRY_MS = 15_000;

export interface FrameEvent {
  sequence: number;
  timestamp_ns: number;
  state: State;
  reason: string;
  world_from_camera: { tx: number; ty: number; tz: number; qx: number; qy: number; qz: number; qw: number } | null;
  submap_id: number;
  is_key_frame: boolean;
  n_keypoints: number;
  n_segments: number;
  n_inlier_points: number;
  n_inlier_lines: number;
  wall_ms: number;
  corrections: { matched_keyframe: number | null; submap_gone: number | null; camera: unknown }[];
}

export interface Listener {
  session(session: Session): void;
  frame(event: FrameEvent): void;
  /** The scene was read to its end, or grew. */
  changed(complete: boolean): void;
  /** How the connection is: `null` is well, a sentence says what is wrong. */
  trouble(sentence: string | null): void;
  gone(): void;
}

/** Follows one session until it is closed. */
export class Follower {
  #events: EventSource | null = null;
  #closed = false;
  #reading = false;
  #wanted = false;
  #lastReading = 0;
  #retry = FIRST_RETRY_MS;
  #timers = new Set<number>();
  readonly #abort = new AbortController();

  constructor(
    private readonly id: string,
    private readonly scene: Scene,
    private readonly listener: Listener,
  ) {
    // What the page carries does not change.
    if (embedded) this.#read();
    else this.#connect();
  }

  close(): void {
    this.#closed = true;
    this.#events?.close();
    this.#abort.abort();
    this.#timers.forEach((timer) => clearTimeout(timer));
  }

  #after(ms: number, run: () => void): void {
    const timer = window.setTimeout(() => {
      this.#timers.delete(timer);
      if (!this.#closed) run();
    }, ms);
    this.#timers.add(timer);
  }

  #connect(): void {
    const events = new EventSource(`${sessionPath(this.id)}/events`);
    this.#events = events;
    // Listening before reading: what happens in between is told by an event and read again.
    events.addEventListener('open', () => {
      this.#retry = FIRST_RETRY_MS;
      this.listener.trouble(null);
      this.#read();
    });
    events.addEventListener('error', () => this.#lostConnection(events));
    const on = <T>(name: string, take: (data: T) => void) =>
      events.addEventListener(name, (event) => take(JSON.parse((event as MessageEvent<string>).data) as T));
    on<Session>('session', (session) => {
      this.scene.metresPerUnit = session.metres_per_unit;
      this.listener.session(session);
    });
    on<FrameEvent>('frame', (event) => {
      this.scene.addLive(liveFrame(event, this.scene.metresPerUnit ?? 1));
      this.listener.frame(event);
    });
    on('scene', () => this.#read());
    on('missed', () => this.#read());
  }

  /** The browser's own attempts end when the server answers with an error; ours begin anew with a question. */
  #lostConnection(events: EventSource): void {
    events.close();
    if (this.#closed || this.#events !== events) return;
    this.#events = null;
    this.#ask();
  }

  #ask(): void {
    request(sessionPath(this.id), { signal: this.#abort.signal }).then(
      () => this.#after(300, () => this.#connect()),
      (error: unknown) => {
        if (this.#closed) return;
        if (error instanceof ApiProblem && error.status === 404) {
          this.listener.gone();
          return;
        }
        const seconds = Math.round(this.#retry / 1000);
        this.listener.trouble(`The server does not answer. Trying again in ${seconds} s; nothing is lost.`);
        this.#after(this.#retry, () => this.#ask());
        this.#retry = Math.min(2 * this.#retry, LONGEST_RETRY_MS);
      },
    );
  }

  #read(): void {
    this.#wanted = true;
    if (this.#reading) return;
    this.#reading = true;
    const wait = Math.max(0, this.#lastReading + MIN_READING_INTERVAL_MS - performance.now());
    this.#after(wait, () => void this.#readNow());
  }

  async #readNow(): Promise<void> {
    this.#wanted = false;
    try {
      const since = this.scene.revision ? `?since=${encodeURIComponent(this.scene.revision)}` : '';
      const response = await request(`${sessionPath(this.id)}/scene${since}`, { signal: this.#abort.signal });
      let lastDrawn = performance.now();
      if (response.body) {
        for await (const line of linesOf(response.body)) {
          this.scene.apply(JSON.parse(line) as ScenePart);
          if (performance.now() - lastDrawn > MIN_READING_INTERVAL_MS) {
            this.listener.changed(false);
            lastDrawn = performance.now();
          }
        }
      }
      this.listener.changed(true);
    } catch {
      // The events' connection notices as well when the server is away, and reads again afterwards.
      if (!this.#closed && this.#events) this.#wanted = true;
    }
    this.#lastReading = performance.now();
    this.#reading = false;
    if (this.#wanted && !this.#closed) this.#read();
  }
}

/** A frame of an event, whose lengths may be metres, as a row of the scene. */
export function liveFrame(event: FrameEvent, metresPerUnit: number): FrameRow {
  const place = event.world_from_camera;
  const pose: Pose | null = place && [
    place.tx / metresPerUnit,
    place.ty / metresPerUnit,
    place.tz / metresPerUnit,
    place.qx,
    place.qy,
    place.qz,
    place.qw,
  ];
  return {
    sequence: event.sequence,
    timeS: event.timestamp_ns * 1e-9,
    state: event.state,
    backfilled: false,
    submap: pose ? event.submap_id : null,
    pose,
    reason: event.reason,
  };
}
