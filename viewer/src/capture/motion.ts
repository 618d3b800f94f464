/** The device's motion sensors, where the browser gives them: their readings go to the server, which keeps them. */

import { request, sessionPath } from '../data/api';

/** Readings a second that are asked for: what browsers give without a special permission. */
const RATE_HZ = 60;
const SEND_EVERY_MS = 1000;

/** Readings that are kept while the server is away, at most: a minute and a half, and as many as one request may have. */
const MAX_HELD = 6000;

type Triple = readonly [number, number, number];

/** The sensors of the Generic Sensor API. */
interface Sensor extends EventTarget {
  readonly x: number | null;
  readonly y: number | null;
  readonly z: number | null;
  /** Milliseconds since the page's time origin. */
  readonly timestamp: number | null;
  start(): void;
  stop(): void;
}
type SensorClass = new (options: { frequency: number }) => Sensor;

/** A reading as a line of a EuRoC recording: nanoseconds, rad/s, m/s². */
export function lineOf(atMs: number, timeOriginMs: number, angularVelocity: Triple, acceleration: Triple): string {
  const ns = BigInt(Math.round((timeOriginMs + atMs) * 1000)) * 1000n;
  return [ns, ...[...angularVelocity, ...acceleration].map((value) => Number(value.toPrecision(7)))].join(',');
}

/** Asks for the sensors where that takes a permission; call when the reader has pressed something. */
export async function allowMotion(): Promise<void> {
  const ask = (globalThis.DeviceMotionEvent as { requestPermission?: () => Promise<string> } | undefined)?.requestPermission;
  // Whoever does not allow it maps without.
  await ask?.().catch(() => {});
}

/** Reads the sensors and sends what they say, in the order of its times, until it is stopped. */
export class MotionSensors {
  #held: string[] = [];
  #lastMs = -Infinity;
  #isSending = false;
  readonly #timer: number;
  readonly #release: (() => void)[] = [];

  constructor(private readonly id: string) {
    this.#timer = window.setInterval(() => void this.#send(), SEND_EVERY_MS);
    if (!this.#readSensors()) this.#readEvents();
  }

  /** Stops reading; what was read is sent. */
  stop(): void {
    clearInterval(this.#timer);
    this.#release.forEach((release) => release());
    void this.#send();
  }

  /** By the sensors of their own, whose axes and units leave no doubt. */
  #readSensors(): boolean {
    const { Gyroscope, Accelerometer } = globalThis as unknown as Record<string, SensorClass | undefined>;
    if (!Gyroscope || !Accelerometer) return false;
    try {
      const [gyroscope, accelerometer] = [new Gyroscope({ frequency: RATE_HZ }), new Accelerometer({ frequency: RATE_HZ })];
      gyroscope.addEventListener('reading', () => {
        const [turn, push] = [tripleOf(gyroscope), tripleOf(accelerometer)];
        if (turn && push && gyroscope.timestamp !== null) this.#take(gyroscope.timestamp, turn, push);
      });
      for (const sensor of [gyroscope, accelerometer]) {
        // A device without it: there are no readings then.
        sensor.addEventListener('error', () => {});
        sensor.start();
        this.#release.push(() => sensor.stop());
      }
      return true;
    } catch {
      return false;
    }
  }

  #readEvents(): void {
    const take = ({ timeStamp, rotationRate, accelerationIncludingGravity }: DeviceMotionEvent) => {
      const { x, y, z } = accelerationIncludingGravity ?? {};
      const { alpha, beta, gamma } = rotationRate ?? {};
      if (x == null || y == null || z == null || alpha == null || beta == null || gamma == null) return;
      // Degrees about the axes x, y and z are called beta, gamma and alpha.
      const turn = [beta, gamma, alpha].map((degrees) => (degrees * Math.PI) / 180) as unknown as Triple;
      this.#take(timeStamp, turn, [x, y, z]);
    };
    addEventListener('devicemotion', take);
    this.#release.push(() => removeEventListener('devicemotion', take));
  }

  #take(atMs: number, turn: Triple, push: Triple): void {
    // Times in microseconds increase from line to line.
    if (atMs < this.#lastMs + 0.002) return;
    this.#lastMs = atMs;
    if (this.#held.length < MAX_HELD) this.#held.push(lineOf(atMs, performance.timeOrigin, turn, push));
  }

  /** Sends what is held. What may have arrived is sent again with what came after it, and takes its own place. */
  async #send(): Promise<void> {
    if (this.#isSending || this.#held.length === 0) return;
    this.#isSending = true;
    const n = this.#held.length;
    try {
      await request(`${sessionPath(this.id)}/motion`, {
        method: 'POST',
        headers: { 'content-type': 'text/csv' },
        body: `${this.#held.join('\n')}\n`,
      });
      this.#held.splice(0, n);
    } catch {
      // The stream of frames tells that the server is away.
    }
    this.#isSending = false;
  }
}

function tripleOf({ x, y, z }: Sensor): Triple | null {
  return x === null || y === null || z === null ? null : [x, y, z];
}
