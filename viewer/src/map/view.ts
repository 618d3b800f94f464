/** The map in three dimensions: what is drawn, from where, and what lies under the pointer. */

import * as THREE from 'three';
import { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
import type { Eye, Layer } from '../address';
import { palette } from '../colors';
import type { Scene } from '../data/scene';
import { theme } from '../theme';
import { FatStrokes, PointCloud, ThinStrokes } from './drawables';
import { placeSubmaps, wholeExtent, type Placement, type Triple } from './layout';
import { edgeStrokes, keyframeStrokes, lineStrokes, pairKey, pointArrays, primitivePairs, pushFrustum, rgb, trajectoryStrokes, type Strokes } from './shapes';

/** Depth of a drawn camera, as a share of the size of the map. */
const FRUSTUM_SHARE = 0.025;

/** Distance of the eye from the middle of everything, in radii of what just fits: room for the legend. */
const FRAMING = 0.95;

/** Points that are drawn while the eye moves, at most, and how long after that all are, ms: a million take a processor
 * without a graphics card a second. */
const MOVING_POINTS = 150_000;
const RESTING_MS = 250;

/** Width of the legend over the left of the map, pixels: the middle of the view lies right of it; on narrow screens the
 * legend is closed. */
const LEGEND_PX = 250;
const LEGEND_FROM_PX = 700;

export interface Shown {
  /** Frames up to this one are drawn. */
  lastFrame: number;
  selected: number | null;
  hidden: Layer[];
  covisibility: [number, number][];
  marks: Triple[];
  follow: boolean;
}

export class MapView {
  readonly canvas: HTMLCanvasElement;
  readonly camera = new THREE.PerspectiveCamera(50, 1, 0.01, 1000);
  readonly controls: OrbitControls;
  placements: Placement[] = [];
  pointIds: Float64Array = new Float64Array();
  pointBornIds: Float32Array = new Float32Array();
  pointPositions: Float32Array = new Float32Array();
  newestKeyframe = 0;
  /** Called when the reader has moved the eye. */
  onEye: (eye: Eye) => void = () => {};
  readonly #renderer: THREE.WebGLRenderer;
  readonly #world = new THREE.Scene();
  readonly #points = new PointCloud();
  readonly #lines = new FatStrokes(2);
  readonly #trajectory = new FatStrokes(3);
  readonly #backfilled = new FatStrokes(2.5, true);
  readonly #keyframes = new ThinStrokes();
  readonly #covisibility = new ThinStrokes(0.55);
  readonly #primitives = new ThinStrokes(0.55);
  readonly #camera = new FatStrokes(2.5);
  readonly #marks = new FatStrokes(3);
  readonly #observer: ResizeObserver;
  #framed = false;
  #pending = false;
  #resting = 0;
  #size = 1;
  primitiveEdges = { drawn: 0, total: 0 };

  constructor(private readonly scene: Scene) {
    this.#renderer = new THREE.WebGLRenderer({ antialias: true });
    this.#renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.canvas = this.#renderer.domElement;
    // The world's y points down, as in the first image.
    this.camera.up.set(0, -1, 0);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.addEventListener('change', () => this.#drawMoving());
    this.controls.addEventListener('end', () => this.tellEye());
    const drawables = [this.#points, this.#lines, this.#trajectory, this.#backfilled, this.#keyframes];
    drawables.push(this.#covisibility, this.#primitives, this.#camera, this.#marks);
    drawables.forEach((drawable) => this.#world.add(drawable.object));
    this.#observer = new ResizeObserver(() => this.#resize());
    this.#observer.observe(this.canvas);
  }

  dispose(): void {
    clearTimeout(this.#resting);
    this.#observer.disconnect();
    this.controls.dispose();
    this.#renderer.dispose();
  }

  tellEye(): void {
    this.onEye({ position: this.camera.position.toArray(), target: this.controls.target.toArray() });
  }

  offsetOf = (submap: number): Triple =>
    this.placements.find((place) => place.submap === submap)?.offset ?? [0, 0, 0];

  /** Takes over the scene's rows; call when they changed. */
  takeScene(): void {
    this.placements = placeSubmaps(this.scene);
    const extent = wholeExtent(this.placements);
    if (extent) {
      this.#size = Math.max(1e-3, Math.hypot(...extent.max.map((end, i) => end - extent.min[i]!)));
      this.camera.near = this.#size / 1000;
      this.camera.far = this.#size * 100;
      this.camera.updateProjectionMatrix();
    }
    const arrays = pointArrays(this.scene, this.offsetOf, theme());
    this.pointIds = arrays.ids;
    this.pointPositions = arrays.positions;
    this.pointBornIds = arrays.bornIds;
    this.#points.set(arrays);
  }

  /** Draws what is to be shown. */
  show(shown: Shown): void {
    const { scene, offsetOf } = this;
    const [colors, now] = [palette(theme()), theme()];
    const newest = shown.lastFrame === Infinity ? Infinity : scene.newestKeyframeId(shown.lastFrame);
    this.newestKeyframe = newest;
    const depth = FRUSTUM_SHARE * this.#size;
    this.#world.background = new THREE.Color(colors.background);
    this.#points.showUpTo(newest);
    this.#lines.set(lineStrokes(scene, offsetOf, now, newest));
    const way = trajectoryStrokes(scene, offsetOf, now, shown.lastFrame);
    this.#trajectory.set(way.answered);
    this.#backfilled.set(way.backfilled);
    this.#keyframes.set(keyframeStrokes(scene, offsetOf, now, newest, depth, shown.selected));
    this.#covisibility.set(edgeStrokes(scene, shown.covisibility, offsetOf, newest, colors.covisibility));
    this.#showPrimitiveEdges(shown, newest, colors.primitiveEdge);
    this.#camera.set(this.#cameraStrokes(shown, 1.8 * depth, colors.camera));
    this.#marks.set(this.#markStrokes(shown.marks, depth / 3, colors.selected));
    const isShown = (layer: Layer) => !shown.hidden.includes(layer);
    this.#points.object.visible = isShown('points');
    this.#lines.object.visible = isShown('lines');
    this.#keyframes.object.visible = isShown('keyframes');
    this.#trajectory.object.visible = this.#backfilled.object.visible = isShown('trajectory');
    this.#covisibility.object.visible = isShown('covisibility');
    this.#primitives.object.visible = isShown('primitives');
    if (!this.#framed && this.placements.length > 0 && scene.points.size > 0) this.frameAll();
    this.draw();
  }

  #showPrimitiveEdges(shown: Shown, newest: number, color: string): void {
    if (shown.hidden.includes('primitives')) return;
    const covisible = new Set(shown.covisibility.map(([a, b]) => pairKey(a, b)));
    const { pairs, total } = primitivePairs(this.scene, covisible);
    this.primitiveEdges = { drawn: pairs.length, total };
    this.#primitives.set(edgeStrokes(this.scene, pairs, this.offsetOf, newest, color));
  }

  /** The camera at the last frame shown that has a pose. */
  #cameraStrokes(shown: Shown, depth: number, color: string): Strokes {
    const strokes: Strokes = { ends: [], colors: [] };
    const frames = this.scene.frameOrder();
    let i = frames.length - 1;
    while (i >= 0 && (frames[i]!.sequence > shown.lastFrame || !frames[i]!.pose)) i -= 1;
    const frame = frames[i];
    if (frame?.pose && frame.submap !== null) {
      const offset = this.offsetOf(frame.submap);
      pushFrustum(strokes, frame.pose, offset, this.scene, depth, rgb(color));
      if (shown.follow) this.#moveTarget([frame.pose[0] + offset[0], frame.pose[1] + offset[1], frame.pose[2] + offset[2]]);
    }
    return strokes;
  }

  #moveTarget(target: Triple): void {
    const step = new THREE.Vector3(...target).sub(this.controls.target);
    this.controls.target.add(step);
    this.camera.position.add(step);
    this.camera.lookAt(this.controls.target);
  }

  #markStrokes(marks: Triple[], radius: number, color: string): Strokes {
    const strokes: Strokes = { ends: [], colors: [] };
    const add = (...ends: number[]) => {
      strokes.ends.push(...ends);
      strokes.colors.push(...rgb(color), ...rgb(color));
    };
    for (const [x, y, z] of marks) {
      add(x - radius, y, z, x + radius, y, z);
      add(x, y - radius, z, x, y + radius, z);
      add(x, y, z - radius, x, y, z + radius);
    }
    if (marks.length === 2) add(...marks[0]!, ...marks[1]!);
    return strokes;
  }

  /** Looks from behind and above at everything. */
  frameAll(): void {
    const extent = wholeExtent(this.placements);
    if (!extent) return;
    this.#framed = true;
    const box = new THREE.Box3(new THREE.Vector3(...extent.min), new THREE.Vector3(...extent.max));
    const sphere = box.getBoundingSphere(new THREE.Sphere());
    const half = Math.tan(THREE.MathUtils.degToRad(this.camera.fov / 2)) * Math.min(1, this.camera.aspect);
    const away = new THREE.Vector3(0.35, -0.75, -1).normalize().multiplyScalar((FRAMING * sphere.radius) / Math.max(half, 0.1));
    this.setEye({ position: sphere.center.clone().add(away).toArray(), target: sphere.center.toArray() });
  }

  setEye(eye: Eye): void {
    this.#framed = true;
    this.camera.position.set(...eye.position);
    this.controls.target.set(...eye.target);
    this.controls.update();
    this.draw();
  }

  /** The map as it is drawn, as the address of a PNG file. */
  picture(): string {
    this.#renderer.render(this.#world, this.camera);
    return this.canvas.toDataURL('image/png');
  }

  /** Draws once before the next refresh of the screen, however often it is asked for. */
  draw(): void {
    if (this.#pending) return;
    this.#pending = true;
    requestAnimationFrame(() => {
      this.#pending = false;
      this.#renderer.render(this.#world, this.camera);
    });
  }

  /** As `draw`, with as many points as can be drawn fluently until the eye rests. */
  #drawMoving(): void {
    if (this.pointIds.length > MOVING_POINTS) {
      this.#points.limit(MOVING_POINTS);
      clearTimeout(this.#resting);
      this.#resting = window.setTimeout(() => {
        this.#points.limit(Infinity);
        this.draw();
      }, RESTING_MS);
    }
    this.draw();
  }

  #resize(): void {
    const { clientWidth, clientHeight } = this.canvas;
    if (clientWidth === 0 || clientHeight === 0) return;
    this.#renderer.setSize(clientWidth, clientHeight, false);
    this.camera.aspect = clientWidth / clientHeight;
    const shift = clientWidth >= LEGEND_FROM_PX ? LEGEND_PX / 2 : 0;
    this.camera.setViewOffset(clientWidth, clientHeight, -shift, 0, clientWidth, clientHeight);
    this.camera.updateProjectionMatrix();
    this.draw();
  }
}
