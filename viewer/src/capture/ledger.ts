/**
 * Which frames of a stream are sent, answered, and safe in the server's database.
 *
 * A frame is held from when it is taken until the server has it on disk or has said that it will not be. After a broken
 * connection the server tells which frame it expects; what it lost is sent again, and becomes part of the map once.
 */

export interface Shot {
  timestampNs: bigint;
  image: Blob;
}

/** Frames without an answer, at most. More would be old by the time the server sees them. */
export const WINDOW = 3;

/**
 * Frames on their way at the same time until those that are sent again are answered: the server drops the oldest when
 * it cannot queue them.
 */
export const CATCH_UP = 2;

/** Memory for frames that are answered and not yet saved, bytes: some 1500 images. Beyond it the oldest are let go. */
export const MAX_HELD_BYTES = 64 * 2 ** 20;

export class Ledger {
  readonly #held = new Map<number, Shot>();
  #heldBytes = 0;
  #next: number | null = null;
  #firstUnanswered = 0;
  #cursor: number | null = null;
  #nInFlight = 0;
  #againTo = 0;
  #answeredTo = 0;

  /** Frames without an answer. */
  get nUnanswered(): number {
    return (this.#next ?? 0) - this.#firstUnanswered;
  }

  /** Frames that are kept in case they must be sent again. */
  get nHeld(): number {
    return this.#held.size;
  }

  get hasRoom(): boolean {
    return this.#cursor !== null && this.nUnanswered < WINDOW;
  }

  /** Nothing is to be sent until the next {@link opened}. */
  disconnected(): void {
    this.#cursor = null;
  }

  /** A connection is open, and the server expects this frame. */
  opened(nextSequence: number): void {
    if (this.#next === null) this.#next = this.#firstUnanswered = nextSequence;
    // Frames that the server has, but whose answer was lost, are answered again and not tracked twice.
    this.#cursor = Math.min(this.#firstUnanswered, nextSequence);
    this.#nInFlight = 0;
    this.#againTo = this.#next;
    this.#answeredTo = this.#cursor;
  }

  /** Takes a frame and gives it the next number. */
  add(shot: Shot): void {
    if (this.#next === null) return;
    this.#held.set(this.#next, shot);
    this.#heldBytes += shot.image.size;
    this.#next += 1;
    for (const sequence of this.#held.keys()) {
      if (this.#heldBytes <= MAX_HELD_BYTES || sequence >= this.#firstUnanswered) break;
      this.#release(sequence);
    }
  }

  /** The next frame to send on this connection; `null` if there is none now. */
  take(): [number, Shot] | null {
    while (this.#cursor !== null && this.#next !== null && this.#cursor < this.#next) {
      if (this.#answeredTo < this.#againTo && this.#nInFlight >= CATCH_UP) return null;
      const sequence = this.#cursor;
      this.#cursor += 1;
      const shot = this.#held.get(sequence);
      if (shot) {
        this.#nInFlight += 1;
        return [sequence, shot];
      }
    }
    return null;
  }

  /**
   * Notes an answer; whether it is the first to its frame. `isKept`: the server has the frame, and it is on disk once
   * `durable` has reached it.
   */
  answered(sequence: number, isKept: boolean, durable: number | null): boolean {
    this.#nInFlight -= 1;
    this.#answeredTo = sequence + 1;
    const isFirst = sequence >= this.#firstUnanswered;
    this.#firstUnanswered = Math.max(this.#firstUnanswered, sequence + 1);
    if (!isKept) this.#release(sequence);
    for (const held of this.#held.keys()) {
      if (durable === null || held > durable) break;
      this.#release(held);
    }
    return isFirst;
  }

  #release(sequence: number): void {
    this.#heldBytes -= this.#held.get(sequence)?.image.size ?? 0;
    this.#held.delete(sequence);
  }
}
