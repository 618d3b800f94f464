import { describe, expect, test } from 'vitest';
import { liveFrame } from '../src/data/live';
import { linesOf, type Pose, type ScenePart } from '../src/data/parts';
import { Scene } from '../src/data/scene';

const AT: Pose = [1, 2, 3, 0, 0, 0, 1];

function head(full: boolean, revision = '1-1'): ScenePart {
  return { scene: { session_id: 's', revision, full, metres_per_unit: null, frustum: [1, 1, -1, -1] } };
}

function points(ids: number[], x = 0): ScenePart {
  return {
    points: {
      ids,
      submap_ids: ids.map(() => 0),
      positions: ids.map(() => [x, 0, 0]),
      grays: ids.map(() => 9),
      created_by: ids.map(() => 1),
    },
  };
}

function keyframes(rows: [number, number, boolean][]): ScenePart {
  return {
    keyframes: {
      ids: rows.map(([id]) => id),
      submap_ids: rows.map(() => 0),
      sequences: rows.map(([, sequence]) => sequence),
      poses: rows.map(() => AT),
      has_image: rows.map(([, , has]) => has),
    },
  };
}

describe('scenes', () => {
  test('a change adds, moves and removes', () => {
    const scene = new Scene();
    [head(true), points([1, 2]), { end: { revision: '1-1' } }].forEach((part) => scene.apply(part));
    const removed = { keyframes: [], points: [2], lines: [], primitives: [] };
    [head(false, '1-2'), { removed }, points([1, 3], 5), { end: { revision: '1-2' } }].forEach((part) => scene.apply(part));
    expect([...scene.points.keys()].sort()).toEqual([1, 3]);
    expect(scene.points.get(1)?.position).toEqual([5, 0, 0]);
    expect(scene.revision).toBe('1-2');
  });

  test('a scene that breaks off is asked for again as a whole', () => {
    const scene = new Scene();
    [head(true), points([1]), { end: { revision: '1-1' } }].forEach((part) => scene.apply(part));
    [head(true, '2-1'), points([4])].forEach((part) => scene.apply(part));
    expect(scene.revision).toBeNull();
    expect([...scene.points.keys()]).toEqual([4]);
  });

  test('a change that breaks off is asked for again', () => {
    const scene = new Scene();
    [head(true), points([1]), { end: { revision: '1-1' } }, head(false, '1-9'), points([2])].forEach((part) => scene.apply(part));
    expect(scene.revision).toBe('1-1');
  });

  test('a stored frame replaces the one that was told live, with a reason of its own', () => {
    const scene = new Scene();
    const pose = { tx: 2, ty: 4, tz: 6, qx: 0, qy: 0, qz: 0, qw: 1 };
    const event = { sequence: 5, timestamp_ns: 2e9, state: 'weak' as const, reason: 'few landmarks', world_from_camera: pose, submap_id: 3 };
    scene.addLive(liveFrame(event as never, 2));
    expect(scene.frames.get(5)).toMatchObject({ pose: AT, submap: 3, timeS: 2 });
    scene.apply({
      frames: { sequences: [5], times_s: [2], states: ['tracked'], backfilled: [true], submap_ids: [1], poses: [AT], reasons: {} },
    });
    expect(scene.frames.get(5)).toMatchObject({ state: 'tracked', backfilled: true, submap: 1, reason: '' });
  });

  test('keyframes are found by time', () => {
    const scene = new Scene();
    scene.apply(keyframes([[1, 0, true], [4, 30, false], [2, 10, true]]));
    expect(scene.keyframeAt(29, false)?.id).toBe(2);
    expect(scene.keyframeAt(99, true)?.id).toBe(2);
    expect(scene.keyframeAt(99, false)?.id).toBe(4);
    expect([scene.newestKeyframeId(9), scene.newestKeyframeId(30), scene.newestKeyframeId(-1)]).toEqual([1, 4, 0]);
  });
});

test('lines come whole however the bytes are cut', async () => {
  const bytes = new TextEncoder().encode('{"a":"grün"}\n{"b":1}\n{"c":2}');
  for (let size = 1; size <= bytes.length; size += 1) {
    const stream = new ReadableStream<Uint8Array>({
      start(controller) {
        for (let i = 0; i < bytes.length; i += size) controller.enqueue(bytes.slice(i, i + size));
        controller.close();
      },
    });
    const lines: string[] = [];
    for await (const line of linesOf(stream)) lines.push(line);
    expect(lines).toEqual(['{"a":"grün"}', '{"b":1}', '{"c":2}']);
  }
});
