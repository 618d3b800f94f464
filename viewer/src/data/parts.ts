/** The parts of a scene as the server sends them, one JSON object a line. */

import type { State } from './api';

export type Pose = [number, number, number, number, number, number, number];

export interface SceneHead {
  session_id: string;
  revision: string;
  full: boolean;
  metres_per_unit: number | null;
  frustum: [number, number, number, number];
}

export interface RemovedRows {
  keyframes: number[];
  points: number[];
  lines: number[];
  primitives: number[];
}

export interface KeyframeColumns {
  ids: number[];
  submap_ids: number[];
  sequences: number[];
  poses: Pose[];
  has_image: boolean[];
}

export interface PrimitiveColumns {
  ids: number[];
  submap_ids: number[];
  directions: [number, number, number][];
  keyframe_ids: number[][];
}

export interface LineColumns {
  ids: number[];
  submap_ids: number[];
  ends: [number, number, number, number, number, number][];
  primitive_ids: (number | null)[];
  created_by: number[];
}

export interface PointColumns {
  ids: number[];
  submap_ids: number[];
  positions: [number, number, number][];
  grays: (number | null)[];
  created_by: number[];
}

export interface FrameColumns {
  sequences: number[];
  times_s: number[];
  states: State[];
  backfilled: boolean[];
  submap_ids: (number | null)[];
  poses: (Pose | null)[];
  reasons: Record<string, string>;
}

export interface ScenePart {
  scene?: SceneHead;
  removed?: RemovedRows;
  keyframes?: KeyframeColumns;
  primitives?: PrimitiveColumns;
  lines?: LineColumns;
  points?: PointColumns;
  frames?: FrameColumns;
  end?: { revision: string };
}

/** Lines of a stream of bytes, as they come; characters may be cut anywhere. */
export async function* linesOf(stream: ReadableStream<Uint8Array>): AsyncGenerator<string> {
  const reader = stream.getReader();
  const decoder = new TextDecoder();
  let rest = '';
  for (;;) {
    const { done, value } = await reader.read();
    rest += done ? decoder.decode() : decoder.decode(value, { stream: true });
    const lines = rest.split('\n');
    rest = lines.pop() ?? '';
    yield* lines.filter((line) => line !== '');
    if (done) {
      if (rest !== '') yield rest;
      return;
    }
  }
}
