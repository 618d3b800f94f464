/** What the holder of the camera should do, and what is known of the lens. */

import type { State } from '../data/api';

/** Short, to be read while walking. */
export const ADVICE: Record<State, string> = {
  initialising: 'Move sideways',
  tracked: 'Good, walk on',
  weak: 'Slower; look at something with edges',
  lost: 'Go back to where you were',
};

/** What the state means, for those who wonder. */
export const MEANING: Record<State, string> = {
  initialising: 'There is no map yet. It needs two views from different places: turning on the spot shows no depth.',
  tracked: 'Come back to places you have been: that takes out drift.',
  weak: 'What is seen hardly tells where the camera is.',
  lost: 'What is seen is not in the map. A view of it is recognized; after a while a new part is begun.',
};

export const DEFAULT_FOV_DEG = 65;
export const FOV_RANGE_DEG: readonly [number, number] = [20, 130];

/** Focal length, pixels, of a camera that sees this angle along the longer side of its image. */
export function focalOfAngle(width: number, height: number, fovDeg: number): number {
  return Math.max(width, height) / 2 / Math.tan((fovDeg * Math.PI) / 360);
}

/** The angle along the longer side, degrees, once the focal length is another by a relative change. */
export function correctedAngle(fovDeg: number, focalChange: number): number {
  return (Math.atan(Math.tan((fovDeg * Math.PI) / 360) / (1 + focalChange)) * 360) / Math.PI;
}

/** A camera of which only the angle is known, as the interface takes it. */
export function assumedCamera(width: number, height: number, fovDeg: number) {
  const focal = focalOfAngle(width, height, fovDeg);
  return { model: 'pinhole', width, height, fx: focal, fy: focal, cx: (width - 1) / 2, cy: (height - 1) / 2, distortion: [] };
}
