import { describe, expect, test } from 'vitest';
import { palette, primitiveColor, shade, stateColor, submapColor } from '../src/colors';
import type { Pose } from '../src/data/parts';
import { Scene, type FrameRow } from '../src/data/scene';
import { placeSubmaps, wholeExtent } from '../src/map/layout';
import { MAX_PRIMITIVE_PAIRS, pointArrays, primitivePairs, spreadingStep, transform, trajectoryStrokes } from '../src/map/shapes';
import { metresPerUnit } from '../src/panels/measure';
import { frameText, spans } from '../src/panels/timeline';

const poseAt = (x: number): Pose => [x, 0, 0, 0, 0, 0, 1];

function sceneOf(submaps: number[]): Scene {
  const scene = new Scene();
  submaps.forEach((submap, i) => {
    scene.keyframes.set(i + 1, { id: i + 1, submap, sequence: i, pose: poseAt(i), hasImage: false });
    for (let n = 0; n < 100; n += 1) {
      const id = 100 * i + n;
      scene.points.set(id, submap, [n / 10, 0, n === 7 ? 1e6 : 1], null, 1);
    }
  });
  return scene;
}

function frame(sequence: number, change: Partial<FrameRow>): FrameRow {
  return { sequence, timeS: 0, state: 'tracked', backfilled: false, submap: 0, pose: poseAt(sequence), reason: '', ...change };
}

/** Contrast of two colors as WCAG defines it. */
function contrast(a: string, b: string): number {
  const luminance = (color: string) => {
    const parts = [1, 3, 5].map((i) => Number.parseInt(color.slice(i, i + 2), 16) / 255);
    const [r, g, bl] = parts.map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4)) as [number, number, number];
    return 0.2126 * r + 0.7152 * g + 0.0722 * bl;
  };
  const [low, high] = [luminance(a), luminance(b)].sort((x, y) => x - y) as [number, number];
  return (high + 0.05) / (low + 0.05);
}

describe('the map', () => {
  test('submaps stand side by side, strays do not count', () => {
    const placements = placeSubmaps(sceneOf([0, 3]));
    const [first, second] = placements;
    expect(first!.offset).toEqual([0, 0, 0]);
    expect(second!.min[0] + second!.offset[0]).toBeGreaterThan(first!.max[0]);
    expect(wholeExtent(placements)!.max[2]).toBeLessThan(10);
    expect(wholeExtent([])).toBeNull();
  });

  test('each beginning of the points is spread over the map, and none is left out', () => {
    const scene = sceneOf([0, 0]);
    const { ids, positions } = pointArrays(scene, () => [1, 0, 0], 'dark');
    expect(Array.from(ids).sort((a, b) => a - b)).toEqual(Array.from({ length: 200 }, (_, i) => i));
    expect(positions[0]).toBeCloseTo((ids[0]! % 100) / 10 + 1, 5);
    const first = Array.from(ids.subarray(0, 20)).map((id) => Math.floor(id / 20));
    expect(new Set(first).size).toBeGreaterThan(8);
    [1, 2, 3, 8, 1000, 1_000_000].forEach((n) => expect(spreadingStep(n)).toBeGreaterThan(0));
  });

  test('poses turn and move points', () => {
    const half = Math.SQRT1_2;
    const turned = transform([10, 20, 30, 0, 0, half, half], [1, 0, 0]);
    [10, 21, 30].forEach((length, i) => expect(turned[i]).toBeCloseTo(length, 12));
  });

  test('the way is broken where there is no pose or another submap, and told apart where it was placed afterwards', () => {
    const scene = new Scene();
    const rows = [frame(0, { backfilled: true }), frame(1, {}), frame(2, {}), frame(3, { pose: null, submap: null }), frame(4, {}), frame(5, { submap: 1 }), frame(6, { submap: 1 })];
    rows.forEach((row) => scene.addLive(row));
    const way = (last: number) => trajectoryStrokes(scene, () => [0, 0, 0], 'dark', last);
    expect(way(Infinity).answered.ends.length / 6).toBe(2);
    expect(way(Infinity).backfilled.ends.length / 6).toBe(1);
    expect(way(1).answered.ends.length).toBe(0);
  });

  test('ties by primitives leave out those that share landmarks, and stay few', () => {
    const scene = sceneOf([0, 0, 0]);
    scene.primitives.set(1, { id: 1, submap: 0, direction: [0, 0, 1], keyframes: [1, 2, 3, 99] });
    expect(primitivePairs(scene, new Set(['1-2'])).pairs).toEqual([[1, 3], [2, 3]]);
    const large = sceneOf(new Array<number>(200).fill(0));
    large.primitives.set(1, { id: 1, submap: 0, direction: [0, 0, 1], keyframes: [...large.keyframes.keys()] });
    const { pairs, total } = primitivePairs(large, new Set());
    expect(total).toBe((200 * 199) / 2);
    expect(pairs.length).toBeLessThanOrEqual(MAX_PRIMITIVE_PAIRS);
    expect(pairs.length).toBeGreaterThan(MAX_PRIMITIVE_PAIRS / 4);
  });
});

describe('panels', () => {
  test('frames of one kind are one span', () => {
    const rows = [frame(0, { state: 'initialising' }), frame(1, { backfilled: true }), frame(2, {}), frame(3, {}), frame(4, { state: 'lost' })];
    expect(spans(rows).map(({ state, backfilled, from, to }) => [state, backfilled, from, to])).toEqual([
      ['initialising', false, 0, 0],
      ['tracked', true, 1, 1],
      ['tracked', false, 2, 3],
      ['lost', false, 4, 4],
    ]);
    expect(spans([])).toEqual([]);
  });

  test('a frame is told with its reason', () => {
    expect(frameText(frame(3, { state: 'initialising', pose: null, reason: 'move sideways' }))).toBe('Frame 3, initialising, no pose: move sideways');
    expect(frameText(frame(4, {}))).toBe('Frame 4, tracked');
  });

  test('a scale is a positive finite number', () => {
    expect(metresPerUnit(2, 3)).toBe(1.5);
    for (const [units, metres] of [[0, 1], [1, 0], [1, -1], [1, NaN], [0, 0]] as const) {
      expect(metresPerUnit(units, metres)).toBeNull();
    }
  });
});

describe('colors', () => {
  test('everything drawn stands out from the background by 3 to 1, in both themes', () => {
    for (const theme of ['dark', 'light'] as const) {
      const { background, ...others } = palette(theme);
      const hues = [0, 1, 2, 3, 4, 5, 6].flatMap((n) => [primitiveColor(n, theme), submapColor(n, theme)]);
      for (const color of [...Object.values(others), ...hues]) {
        expect(contrast(color, background), `${color} on ${background}`).toBeGreaterThan(3);
      }
      for (const state of ['tracked', 'weak', 'lost'] as const) {
        expect(contrast(stateColor(state, theme), background), state).toBeGreaterThan(2.4);
      }
    }
  });

  test('shades keep the order of grays', () => {
    for (const theme of ['dark', 'light'] as const) {
      const shades = [0, 50, 128, 255].map((gray) => shade(gray, theme));
      expect(shades).toEqual([...shades].sort((a, b) => a - b));
    }
  });
});
