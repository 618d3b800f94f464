/** Where submaps are drawn. They share no frame of reference, so they stand side by side, none over another. */

import type { Scene } from '../data/scene';

export type Triple = [number, number, number];

export interface Placement {
  submap: number;
  /** Added to the submap's coordinates. */
  offset: Triple;
  min: Triple;
  max: Triple;
}

/** Share of the landmarks at each end of an axis that does not count for the size of a submap: strays. */
const STRAY_SHARE = 0.02;
/** Room between two submaps, as a share of the larger one. */
const GAP_SHARE = 0.4;

function range(values: Float32Array): [number, number] {
  if (values.length === 0) return [0, 0];
  values.sort();
  const skipped = Math.floor(values.length * STRAY_SHARE);
  return [values[skipped]!, values[values.length - 1 - skipped]!];
}

/** Points of a submap that are looked at for its size, at most: more would not change it. */
const MAX_SAMPLED = 50_000;

/** Rows of points by their submap, of a large map one in so many. */
function sampleRows({ points }: Scene): Map<number, number[]> {
  const rows = new Map<number, number[]>();
  const step = Math.ceil(points.size / MAX_SAMPLED);
  for (let i = 0; i < points.size; i += step) {
    const submap = points.submaps[i]!;
    const known = rows.get(submap);
    if (known) known.push(i);
    else rows.set(submap, [i]);
  }
  return rows;
}

/** The box most of a submap is in. */
function extent(scene: Scene, submap: number, rows: number[]): { min: Triple; max: Triple } {
  const { positions } = scene.points;
  const axes = [0, 1, 2].map((axis) => Float32Array.from(rows, (row) => positions[3 * row + axis]!));
  const ranges = axes.map(range);
  for (const keyframe of scene.keyframes.values()) {
    if (keyframe.submap !== submap) continue;
    ranges.forEach((ends, i) => {
      const place = keyframe.pose[i]!;
      const empty = rows.length === 0 && ends[0] === 0 && ends[1] === 0;
      ranges[i] = empty ? [place, place] : [Math.min(ends[0]!, place), Math.max(ends[1]!, place)];
    });
  }
  const [x, y, z] = ranges as [[number, number], [number, number], [number, number]];
  return { min: [x[0], y[0], z[0]], max: [x[1], y[1], z[1]] };
}

/** Places every submap: the first where it is, the others to its right. */
export function placeSubmaps(scene: Scene): Placement[] {
  const placements: Placement[] = [];
  const rows = sampleRows(scene);
  for (const submap of scene.submaps()) {
    const { min, max } = extent(scene, submap, rows.get(submap) ?? []);
    const before = placements.at(-1);
    let offset: Triple = [0, 0, 0];
    if (before) {
      const width = Math.max(max[0] - min[0], before.max[0] - before.min[0]);
      const left = before.max[0] + before.offset[0] + GAP_SHARE * Math.max(width, 1e-3);
      const middle = (i: 1 | 2) => (before.min[i] + before.max[i]) / 2 + before.offset[i] - (min[i] + max[i]) / 2;
      offset = [left - min[0], middle(1), middle(2)];
    }
    placements.push({ submap, offset, min, max });
  }
  return placements;
}

/** The box around everything that was placed; `null` if there is nothing. */
export function wholeExtent(placements: Placement[]): { min: Triple; max: Triple } | null {
  if (placements.length === 0) return null;
  const end = (pick: (...numbers: number[]) => number, key: 'min' | 'max') =>
    [0, 1, 2].map((i) => pick(...placements.map((place) => place[key][i]! + place.offset[i]!))) as Triple;
  return { min: end(Math.min, 'min'), max: end(Math.max, 'max') };
}
