/** Points and strokes as the graphics card takes them. */

import * as THREE from 'three';
import { LineMaterial } from 'three/examples/jsm/lines/LineMaterial.js';
import { LineSegments2 } from 'three/examples/jsm/lines/LineSegments2.js';
import { LineSegmentsGeometry } from 'three/examples/jsm/lines/LineSegmentsGeometry.js';
import type { PointArrays, Strokes } from './shapes';

/** Side of a point's square, pixels of the screen. */
const POINT_PX = 2.6;

/** Points in shades of gray; those made by later keyframes than the newest shown are left out. */
export class PointCloud {
  readonly object: THREE.Points;
  readonly #material: THREE.ShaderMaterial;

  constructor() {
    this.#material = new THREE.ShaderMaterial({
      uniforms: { newest: { value: 1e9 }, size: { value: POINT_PX * Math.min(devicePixelRatio, 2) } },
      vertexShader: `
        attribute float shade;
        attribute float born;
        uniform float newest;
        uniform float size;
        varying float vShade;
        void main() {
          vShade = shade;
          gl_Position = born > newest ? vec4(2.0, 2.0, 2.0, 1.0) : projectionMatrix * modelViewMatrix * vec4(position, 1.0);
          gl_PointSize = size;
        }`,
      fragmentShader: `
        varying float vShade;
        void main() { gl_FragColor = vec4(vec3(vShade), 1.0); }`,
    });
    this.object = new THREE.Points(new THREE.BufferGeometry(), this.#material);
    this.object.frustumCulled = false;
  }

  set(arrays: PointArrays): void {
    this.object.geometry.dispose();
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute('position', new THREE.BufferAttribute(arrays.positions, 3));
    geometry.setAttribute('shade', new THREE.BufferAttribute(arrays.shades, 1));
    geometry.setAttribute('born', new THREE.BufferAttribute(arrays.bornIds, 1));
    this.object.geometry = geometry;
  }

  /** Draws so many points at most, spread over the map. */
  limit(n: number): void {
    this.object.geometry.setDrawRange(0, n);
  }

  showUpTo(newest: number): void {
    this.#material.uniforms['newest']!.value = Math.min(newest, 1e9);
  }
}

/** Strokes one pixel wide. */
export class ThinStrokes {
  readonly object: THREE.LineSegments;

  constructor(opacity = 1) {
    const material = new THREE.LineBasicMaterial({ vertexColors: true, transparent: opacity < 1, opacity });
    this.object = new THREE.LineSegments(new THREE.BufferGeometry(), material);
    this.object.frustumCulled = false;
  }

  set({ ends, colors }: Strokes): void {
    this.object.geometry.dispose();
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute('position', new THREE.Float32BufferAttribute(ends, 3));
    geometry.setAttribute('color', new THREE.Float32BufferAttribute(linear(colors), 3));
    this.object.geometry = geometry;
  }
}

/** Strokes of several pixels, whole or dashed. */
export class FatStrokes {
  readonly object: THREE.Group;
  readonly #material: LineMaterial;
  readonly #dashed: boolean;

  constructor(widthPx: number, dashed = false) {
    this.#dashed = dashed;
    this.#material = new LineMaterial({ linewidth: widthPx, vertexColors: true, dashed });
    this.object = new THREE.Group();
  }

  set({ ends, colors }: Strokes): void {
    for (const child of [...this.object.children]) {
      (child as LineSegments2).geometry.dispose();
      this.object.remove(child);
    }
    if (ends.length === 0) return;
    const geometry = new LineSegmentsGeometry();
    geometry.setPositions(ends);
    geometry.setColors(linear(colors));
    const strokes = new LineSegments2(geometry, this.#material);
    strokes.frustumCulled = false;
    if (this.#dashed) this.#setDashes(ends, geometry);
    this.object.add(strokes);
  }

  /** Strokes follow one another from frame to frame: every other one is left out, whatever their lengths. */
  #setDashes(ends: number[], geometry: LineSegmentsGeometry): void {
    const n = ends.length / 6;
    const distances = new Float32Array(2 * n);
    for (let i = 0; i < n; i += 1) {
      distances[2 * i] = i;
      distances[2 * i + 1] = i + 1;
    }
    const buffer = new THREE.InstancedInterleavedBuffer(distances, 2, 1);
    geometry.setAttribute('instanceDistanceStart', new THREE.InterleavedBufferAttribute(buffer, 1, 0));
    geometry.setAttribute('instanceDistanceEnd', new THREE.InterleavedBufferAttribute(buffer, 1, 1));
    this.#material.dashSize = 0.55;
    this.#material.gapSize = 0.45;
  }
}

/** Colors of the style sheet as the renderer computes with them. */
function linear(colors: number[]): number[] {
  return colors.map((value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4));
}
