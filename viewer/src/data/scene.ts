/** A session's map and trajectory as the page holds it, brought up to date part by part. */

import type { State } from './api';
import { PointTable } from './points';
import type { FrameColumns, Pose, ScenePart } from './parts';

export interface KeyframeRow {
  id: number;
  submap: number;
  sequence: number;
  pose: Pose;
  hasImage: boolean;
}

export interface PrimitiveRow {
  id: number;
  submap: number;
  direction: [number, number, number];
  keyframes: number[];
}

export interface LineRow {
  id: number;
  submap: number;
  ends: [number, number, number, number, number, number];
  primitive: number | null;
  createdBy: number;
}

export interface FrameRow {
  sequence: number;
  timeS: number;
  state: State;
  backfilled: boolean;
  submap: number | null;
  pose: Pose | null;
  reason: string;
}

/** See the module's documentation. Lengths are map units. */
export class Scene {
  readonly keyframes = new Map<number, KeyframeRow>();
  readonly primitives = new Map<number, PrimitiveRow>();
  readonly lines = new Map<number, LineRow>();
  readonly points = new PointTable();
  readonly frames = new Map<number, FrameRow>();
  frustum: [number, number, number, number] = [0.6, 0.45, -0.6, -0.45];
  metresPerUnit: number | null = null;
  /** What the server is asked for the changes since; `null` until a scene has come to its end. */
  revision: string | null = null;
  #order: FrameRow[] | null = null;

  /** Takes over a part. */
  apply(part: ScenePart): void {
    if (part.scene) {
      this.metresPerUnit = part.scene.metres_per_unit;
      this.frustum = part.scene.frustum;
      if (part.scene.full) this.#clear();
    }
    if (part.removed) {
      part.removed.keyframes.forEach((id) => this.keyframes.delete(id));
      part.removed.primitives.forEach((id) => this.primitives.delete(id));
      part.removed.lines.forEach((id) => this.lines.delete(id));
      part.removed.points.forEach((id) => this.points.delete(id));
    }
    this.#applyRows(part);
    if (part.end) this.revision = part.end.revision;
  }

  /** Notes a frame that was just tracked; the stored frame replaces it later. */
  addLive(frame: FrameRow): void {
    this.frames.set(frame.sequence, frame);
    this.#order = null;
  }

  /** Frames in the order of their numbers. */
  frameOrder(): FrameRow[] {
    this.#order ??= [...this.frames.values()].sort((a, b) => a.sequence - b.sequence);
    return this.#order;
  }

  /** Submaps that hold anything, in the order of their numbers. */
  submaps(): number[] {
    return [...new Set([...this.keyframes.values()].map((row) => row.submap))].sort((a, b) => a - b);
  }

  /** The keyframe that was newest at a frame; with `hasImage`, of those whose image was kept. */
  keyframeAt(sequence: number, hasImage: boolean): KeyframeRow | null {
    let best: KeyframeRow | null = null;
    for (const row of this.keyframes.values()) {
      const fits = row.sequence <= sequence && (row.hasImage || !hasImage);
      if (fits && (!best || row.sequence > best.sequence)) best = row;
    }
    return best;
  }

  /** The highest id of a keyframe there was at a frame: what was made by a later one was not there yet. */
  newestKeyframeId(sequence: number): number {
    let id = 0;
    for (const row of this.keyframes.values()) {
      if (row.sequence <= sequence && row.id > id) id = row.id;
    }
    return id;
  }

  #clear(): void {
    // Frames stay: those not saved yet are in no answer.
    for (const rows of [this.keyframes, this.primitives, this.lines, this.points]) rows.clear();
    this.revision = null;
  }

  #applyRows({ keyframes, primitives, lines, points, frames }: ScenePart): void {
    keyframes?.ids.forEach((id, i) =>
      this.keyframes.set(id, {
        id,
        submap: keyframes.submap_ids[i]!,
        sequence: keyframes.sequences[i]!,
        pose: keyframes.poses[i]!,
        hasImage: keyframes.has_image[i]!,
      }),
    );
    primitives?.ids.forEach((id, i) =>
      this.primitives.set(id, {
        id,
        submap: primitives.submap_ids[i]!,
        direction: primitives.directions[i]!,
        keyframes: primitives.keyframe_ids[i]!,
      }),
    );
    lines?.ids.forEach((id, i) =>
      this.lines.set(id, {
        id,
        submap: lines.submap_ids[i]!,
        ends: lines.ends[i]!,
        primitive: lines.primitive_ids[i]!,
        createdBy: lines.created_by[i]!,
      }),
    );
    points?.ids.forEach((id, i) =>
      this.points.set(id, points.submap_ids[i]!, points.positions[i]!, points.grays[i]!, points.created_by[i]!),
    );
    if (frames) this.#applyFrames(frames);
  }

  #applyFrames(frames: FrameColumns): void {
    frames.sequences.forEach((sequence, i) => {
      this.frames.set(sequence, {
        sequence,
        timeS: frames.times_s[i]!,
        state: frames.states[i]!,
        backfilled: frames.backfilled[i]!,
        submap: frames.submap_ids[i]!,
        pose: frames.poses[i]!,
        reason: frames.reasons[String(sequence)] ?? '',
      });
    });
    this.#order = null;
  }
}
