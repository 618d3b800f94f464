/** Coordinates of what is drawn of a scene, as flat lists of numbers; no graphics library in here. */

import { palette, primitiveColor, shade, submapColor } from '../colors';
import type { Pose } from '../data/parts';
import type { Scene } from '../data/scene';
import type { Theme } from '../theme';
import type { Triple } from './layout';

export type OffsetOf = (submap: number) => Triple;

/** Strokes: two ends of three numbers each, and a color for each end. */
export interface Strokes {
  ends: number[];
  colors: number[];
}

export function rgb(color: string): Triple {
  const value = Number.parseInt(color.slice(1), 16);
  return [((value >> 16) & 255) / 255, ((value >> 8) & 255) / 255, (value & 255) / 255];
}

/** A point in a camera's frame, brought to the world by `world_from_camera`. */
export function transform(pose: Pose, point: Triple): Triple {
  const [tx, ty, tz, x, y, z, w] = pose;
  const [px, py, pz] = point;
  const ux = 2 * (y * pz - z * py);
  const uy = 2 * (z * px - x * pz);
  const uz = 2 * (x * py - y * px);
  return [
    px + w * ux + y * uz - z * uy + tx,
    py + w * uy + z * ux - x * uz + ty,
    pz + w * uz + x * uy - y * ux + tz,
  ];
}

const plus = (a: Triple, b: Triple): Triple => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];

function stroke(strokes: Strokes, a: Triple, b: Triple, color: Triple): void {
  strokes.ends.push(...a, ...b);
  strokes.colors.push(...color, ...color);
}

/** The outline of what a camera sees, as deep as `depth`. */
export function pushFrustum(strokes: Strokes, pose: Pose, offset: Triple, scene: Scene, depth: number, color: Triple): void {
  const [right, lower, left, upper] = scene.frustum;
  const corner = (x: number, y: number) => plus(transform(pose, [x * depth, y * depth, depth]), offset);
  const apex = plus([pose[0], pose[1], pose[2]], offset);
  const corners = [corner(left, upper), corner(right, upper), corner(right, lower), corner(left, lower)];
  corners.forEach((here, i) => {
    stroke(strokes, apex, here, color);
    stroke(strokes, here, corners[(i + 1) % 4]!, color);
  });
  // A mark on the upper side, so that it is seen which way up the image is.
  const middle = (left + right) / 2;
  stroke(strokes, corners[0]!, corner(middle, upper * 1.35), color);
  stroke(strokes, corners[1]!, corner(middle, upper * 1.35), color);
}

export interface PointArrays {
  positions: Float32Array;
  shades: Float32Array;
  bornIds: Float32Array;
  ids: Float64Array;
}

/** How far apart in the table points lie that follow one another, so that the first of any number of them are spread
 * over the whole map: near the golden section, and prime to `n`. */
export function spreadingStep(n: number): number {
  const divisor = (a: number, b: number): number => (b === 0 ? a : divisor(b, a % b));
  let step = Math.max(1, Math.round(0.618 * n));
  while (divisor(step, n) > 1) step += 1;
  return step;
}

/** Points as they are drawn, each beginning of them spread over the map. */
export function pointArrays(scene: Scene, offsetOf: OffsetOf, theme: Theme): PointArrays {
  const { points } = scene;
  const n = points.size;
  const [positions, shades] = [new Float32Array(3 * n), new Float32Array(n)];
  const [bornIds, ids] = [new Float32Array(n), new Float64Array(n)];
  const offsets = new Map<number, Triple>();
  const step = spreadingStep(n);
  for (let i = 0, row = 0; i < n; i += 1, row = (row + step) % n) {
    const submap = points.submaps[row]!;
    let offset = offsets.get(submap);
    if (!offset) offsets.set(submap, (offset = offsetOf(submap)));
    for (let axis = 0; axis < 3; axis += 1) positions[3 * i + axis] = points.positions[3 * row + axis]! + offset[axis]!;
    shades[i] = shade(points.grayAt(row), theme);
    bornIds[i] = points.createdBy[row]!;
    ids[i] = points.ids[row]!;
  }
  return { positions, shades, bornIds, ids };
}

/** Lines made by keyframes up to `newest`, colored by their global primitives. */
export function lineStrokes(scene: Scene, offsetOf: OffsetOf, theme: Theme, newest: number): Strokes {
  const strokes: Strokes = { ends: [], colors: [] };
  for (const line of scene.lines.values()) {
    if (line.createdBy > newest) continue;
    const [a, b, c, d, e, f] = line.ends;
    const offset = offsetOf(line.submap);
    stroke(strokes, plus([a, b, c], offset), plus([d, e, f], offset), rgb(primitiveColor(line.primitive, theme)));
  }
  return strokes;
}

export function keyframeStrokes(
  scene: Scene,
  offsetOf: OffsetOf,
  theme: Theme,
  newest: number,
  depth: number,
  selected: number | null,
): Strokes {
  const strokes: Strokes = { ends: [], colors: [] };
  const colors = palette(theme);
  for (const row of scene.keyframes.values()) {
    if (row.id > newest && row.id !== selected) continue;
    const color = rgb(row.id === selected ? colors.selected : colors.keyframe);
    pushFrustum(strokes, row.pose, offsetOf(row.submap), scene, row.id === selected ? 1.5 * depth : depth, color);
  }
  return strokes;
}

/** The way from frame to frame up to `last`: as it was answered, and what was found afterwards. */
export function trajectoryStrokes(scene: Scene, offsetOf: OffsetOf, theme: Theme, last: number): { answered: Strokes; backfilled: Strokes } {
  const answered: Strokes = { ends: [], colors: [] };
  const backfilled: Strokes = { ends: [], colors: [] };
  let before = null;
  for (const frame of scene.frameOrder()) {
    if (frame.sequence > last) break;
    const { pose, submap } = frame;
    if (!pose || submap === null) {
      before = null;
      continue;
    }
    const here = plus([pose[0], pose[1], pose[2]], offsetOf(submap));
    if (before && before.submap === submap) {
      const strokes = frame.backfilled || before.backfilled ? backfilled : answered;
      stroke(strokes, before.here, here, rgb(submapColor(submap, theme)));
    }
    before = { submap, here, backfilled: frame.backfilled };
  }
  return { answered, backfilled };
}

/** Strokes between the cameras of pairs of keyframes of one submap. */
export function edgeStrokes(scene: Scene, pairs: Iterable<[number, number]>, offsetOf: OffsetOf, newest: number, color: string): Strokes {
  const strokes: Strokes = { ends: [], colors: [] };
  for (const [a, b] of pairs) {
    const [from, to] = [scene.keyframes.get(a), scene.keyframes.get(b)];
    if (!from || !to || a > newest || b > newest || from.submap !== to.submap) continue;
    const center = (row: typeof from) => plus([row.pose[0], row.pose[1], row.pose[2]], offsetOf(row.submap));
    stroke(strokes, center(from), center(to), rgb(color));
  }
  return strokes;
}

/** Pairs drawn of the graph of primitives at most: it has all pairs of each primitive's keyframes. */
export const MAX_PRIMITIVE_PAIRS = 3000;

/**
 * Pairs of keyframes that show the same primitive, without those that `covisible` holds: what no other landmark ties.
 * Where there are too many, an even choice of them.
 */
export function primitivePairs(scene: Scene, covisible: Set<string>): { pairs: [number, number][]; total: number } {
  const pairs: [number, number][] = [];
  const told = new Set<string>();
  let total = 0;
  let every = 1;
  for (const primitive of scene.primitives.values()) {
    const present = primitive.keyframes.filter((id) => scene.keyframes.has(id));
    for (let i = 0; i < present.length; i += 1) {
      for (let j = i + 1; j < present.length; j += 1) {
        const key = pairKey(present[i]!, present[j]!);
        if (covisible.has(key) || told.has(key)) continue;
        if (told.size < 100_000) told.add(key);
        if (total % every === 0) pairs.push([present[i]!, present[j]!]);
        total += 1;
        if (pairs.length > MAX_PRIMITIVE_PAIRS) {
          every *= 2;
          pairs.splice(0, pairs.length, ...pairs.filter((_, k) => k % 2 === 0));
        }
      }
    }
  }
  return { pairs, total };
}

export const pairKey = (a: number, b: number): string => (a < b ? `${a}-${b}` : `${b}-${a}`);
