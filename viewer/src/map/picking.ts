/** What lies under the pointer, and moving the eye by keys. */

import * as THREE from 'three';
import type { Scene } from '../data/scene';
import type { Triple } from './layout';
import type { MapView } from './view';

/** How far from the pointer something may be to be meant, pixels: a fingertip is broad. */
const REACH_PX: Record<string, number> = { mouse: 10, pen: 14, touch: 26 };

export interface ScreenPlace {
  x: number;
  y: number;
  pointer: string;
}

function nearest(view: MapView, at: ScreenPlace, candidates: Iterable<[number, Triple]>): [number, Triple] | null {
  const { clientWidth, clientHeight } = view.canvas;
  const reach = REACH_PX[at.pointer] ?? 10;
  const place = new THREE.Vector3();
  let best: [number, Triple] | null = null;
  let bestDistance = reach;
  view.camera.updateMatrixWorld();
  for (const [id, position] of candidates) {
    place.set(...position).project(view.camera);
    if (place.z < -1 || place.z > 1) continue;
    const dx = ((place.x + 1) / 2) * clientWidth - at.x;
    const dy = ((1 - place.y) / 2) * clientHeight - at.y;
    const distance = Math.hypot(dx, dy);
    if (distance < bestDistance) {
      best = [id, position];
      bestDistance = distance;
    }
  }
  return best;
}

/** The keyframe whose camera is under the pointer. */
export function pickKeyframe(view: MapView, scene: Scene, at: ScreenPlace): number | null {
  function* centers(): Generator<[number, Triple]> {
    for (const row of scene.keyframes.values()) {
      if (row.id > view.newestKeyframe) continue;
      const offset = view.offsetOf(row.submap);
      yield [row.id, [row.pose[0] + offset[0], row.pose[1] + offset[1], row.pose[2] + offset[2]]];
    }
  }
  return nearest(view, at, centers())?.[0] ?? null;
}

/** The point of the map under the pointer. */
export function pickPoint(view: MapView, at: ScreenPlace): { id: number; position: Triple } | null {
  function* points(): Generator<[number, Triple]> {
    const p = view.pointPositions;
    for (let i = 0; i < view.pointIds.length; i += 1) {
      // What is not drawn yet cannot be meant.
      if (view.pointBornIds[i]! > view.newestKeyframe) continue;
      yield [view.pointIds[i]!, [p[3 * i]!, p[3 * i + 1]!, p[3 * i + 2]!]];
    }
  }
  const found = nearest(view, at, points());
  return found && { id: found[0], position: found[1] };
}

/** Angle one key press turns the eye by, radians, and the factor it comes nearer by. */
const STEP_RAD = 0.1;
const STEP_FACTOR = 1.15;

/** Moves the eye by arrow keys (with shift: sideways), plus and minus, and Home; says whether the key was one. */
export function moveByKey(view: MapView, event: KeyboardEvent): boolean {
  const { camera, controls } = view;
  const offset = camera.position.clone().sub(controls.target);
  const toUp = new THREE.Quaternion().setFromUnitVectors(camera.up, new THREE.Vector3(0, 1, 0));
  const spherical = new THREE.Spherical().setFromVector3(offset.clone().applyQuaternion(toUp));
  const step: Record<string, [number, number]> = {
    ArrowLeft: [-1, 0],
    ArrowRight: [1, 0],
    ArrowUp: [0, -1],
    ArrowDown: [0, 1],
  };
  const [right, down] = step[event.key] ?? [0, 0];
  if (event.key === 'Home') {
    view.frameAll();
  } else if (event.key === '+' || event.key === '=' || event.key === '-') {
    offset.multiplyScalar(event.key === '-' ? STEP_FACTOR : 1 / STEP_FACTOR);
    camera.position.copy(controls.target).add(offset);
  } else if (right === 0 && down === 0) {
    return false;
  } else if (event.shiftKey) {
    const move = new THREE.Vector3(right, -down, 0).applyQuaternion(camera.quaternion);
    move.multiplyScalar(0.05 * offset.length());
    camera.position.add(move);
    controls.target.add(move);
  } else {
    spherical.theta += STEP_RAD * right;
    spherical.phi = THREE.MathUtils.clamp(spherical.phi + STEP_RAD * down, 0.02, Math.PI - 0.02);
    offset.setFromSpherical(spherical).applyQuaternion(toUp.invert());
    camera.position.copy(controls.target).add(offset);
  }
  controls.update();
  view.draw();
  view.tellEye();
  return true;
}
